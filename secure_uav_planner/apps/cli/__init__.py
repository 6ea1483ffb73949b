"""The command `secure_uav_planner`, which needs no ROS; its parts are imported when they run."""
