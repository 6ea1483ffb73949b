"""The colours of all views, by Okabe and Ito, which colour-blind people can distinguish."""

GROUND_NODE = '#000000'
EAVESDROPPER = '#D55E00'
NO_FLY_ZONE = '#7A7A7A'
GEOFENCE = '#3C3C3C'
MARGIN = '#F4D58A'
RATE = '#6A3D9A'

_UAVS = ('#0072B2', '#E69F00', '#009E73', '#CC79A7', '#56B4E9', '#F0E442')


def uav_color(index):
    """Return the colour of a UAV by index, '#rrggbb'; UAV 0 transmits."""
    return _UAVS[0] if index == 0 else _UAVS[1 + (index - 1) % (len(_UAVS) - 1)]
