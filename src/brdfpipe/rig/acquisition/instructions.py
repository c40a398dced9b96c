"""What an operator is asked to arrange by hand."""

from __future__ import annotations

from brdfpipe.rig.plan import LINE_LAMP, MIRROR, Arrangement
from brdfpipe.rig.turned_mirror import normal_angles


def instruction(arrangement: Arrangement, sample: str) -> str:
    """An arrangement in words; ``sample`` is the name of what is in the holder."""
    entrance, again = f"{arrangement.incidence:g} degree entrance", " again" if arrangement.again else ""
    if arrangement.load == LINE_LAMP:
        return "line lamp in place of the lamp"
    if arrangement.load == "etalon":
        return f"etalon{again} in the holder, turned to the {entrance}, mirrors set to that entrance"
    if arrangement.load == "target":
        return f"target in the holder, mirrors set to the {entrance}"
    if arrangement.load == MIRROR and arrangement.aim is not None:
        normal = normal_angles(arrangement.incidence, arrangement.aim)
        return (
            f"mirror in the holder, its normal at theta_s = {normal[0]:.2f} and phi_s = {normal[1]:.2f} degree, so that it sends the light "
            f"to ({arrangement.aim[0]:g}, {arrangement.aim[1]:g}), mirrors set to the {entrance}"
        )
    return f"{sample}{again} in the holder, at {arrangement.incidence:g} degree, for {arrangement.side}"
