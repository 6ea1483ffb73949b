"""A mission file in which every field is explained."""

EXAMPLE = """\
# A mission of secure_uav_planner. Positions are (x, y) in m, x to the east and y to the north of
# an origin of your choice. Heights are in m above the ground node, times in s, speeds in m/s and
# powers in W. Fields with a default may be left out; each says which.

ground_node: [0.0, 0.0]           # m, where the data must arrive, at height 0

# Where eavesdroppers are believed to be: each is somewhere in a disc. At least one.
eavesdroppers:
  - name: eavesdropper            # default: eavesdropper
    position: [200.0, 0.0]        # m, centre of the disc
    error_radius: 10.0            # m, radius of the disc; default: 0
    receiver_advantage_db: 0.0    # dB, by which its receiver is better than the ground node's;
                                  # default: 0

# The first UAV transmits, the others jam. At least one.
uavs:
  - &sender                       # so that others can say only what is different
    name: sender
    start: [90.0, 300.0]          # m
    goal: [90.0, -300.0]          # m
    altitude: 100.0               # m, all the way
    max_speed: 10.0               # m/s
    average_power: 1.0            # W, limit of the mean over the mission; default: 1
    peak_power: 4.0               # W, limit at any time; default: 4
    max_acceleration: 3.0         # m/s^2; null (the default) for no limit
    start_velocity: [0.0, 0.0]    # m/s, counts with a limit of acceleration; null: free
    goal_velocity: [0.0, 0.0]     # m/s, likewise
    propulsion:                   # of a rotary wing, for the energy; default: null, no energy
      blade_power: 79.8563        # W, while hovering
      induced_power: 88.6279      # W, while hovering
      tip_speed: 120.0            # m/s, of the rotor blades
      induced_velocity: 4.03      # m/s, while hovering
      fuselage_drag_ratio: 0.6
      air_density: 1.225          # kg/m^3
      solidity: 0.05              # of the rotor
      disc_area: 0.503            # m^2, of the rotor; defaults: these numbers
  - <<: *sender                   # all as above, except
    name: jammer
    start: [120.0, 300.0]
    goal: [120.0, -300.0]

duration: 90.0                    # s, T
slots: 90                         # N: power is chosen anew every T/N
reference_snr_db: 80.0            # dB, beta_0 / sigma^2: SNR at 1 m and 1 W; default: 80;
                                  # secure_uav_planner link-budget --help computes it

separation: 20.0                  # m, between any two UAVs at any time; default: 0, no limit

no_fly_zones: []                  # default: none; for example:
#  - name: tower
#    vertices: [[80, 90], [120, 90], [120, 110], [80, 110]]   # m, a polygon
#    floor: 0.0                   # m, forbidden from this height; default: 0
#    ceiling: 150.0               # m, up to this one; null (the default) for all above

geofence: null                    # m, vertices of a polygon that no UAV leaves; default: none

tracking_margin: 0.0              # m, largest error of a vehicle on its plan, which keeps that
                                  # much more away from zones and fence, and twice that more from
                                  # others where there is a separation; default: 0

channel:                          # default: free space without fading
  exponent: 2.0                   # path loss exponent, 2 to 6; default: 2
  los: null                       # probability of a line of sight: suburban, urban, dense_urban,
                                  # highrise, or [a, b, extra loss in dB]; null (the default) for
                                  # a line of sight everywhere
  cautious: false                 # true: what leaks or interferes has a line of sight
  rician_k_db: null               # dB, Rician factor of the fading; null (the default) for none
  outage: null                    # with fading: probability that a slot's secrecy rate is lower

colluding: false                  # true: eavesdroppers put together what they hear
"""
"""What `secure_uav_planner new` writes."""
