"""The command `secure_uav_planner`, which needs no ROS: a module for each of its parts."""
