"""Plans flown in physics: simulated quadrotors follow the replay node's setpoints over DDS."""
