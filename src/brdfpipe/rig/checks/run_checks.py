"""The checks of :mod:`brdfpipe.rig.checks.frame_judge` on the frames of a stored run: what a scan would have refused."""

from __future__ import annotations

from collections.abc import Iterator

import numpy as np
import xarray as xr

from brdfpipe.rig.checks.frame_judge import Finding, FrameJudge
from brdfpipe.rig.description import Rig
from brdfpipe.rig.plan import ETALON_AFTER, LINE_LAMP, Arrangement, Shot


def run_findings(frames: xr.Dataset, rig: Rig) -> list[tuple[Shot, Finding]]:
    """Findings on frames of kind ``frames``, in the order in which they were taken; dark frames are learnt first."""
    # One arrangement has nothing else to show exchanged frames by.
    judge = FrameJudge(rig, steady_lamp=True)
    shots = list(_shots(frames))
    last = {_key(shot): shot.ordinal for shot in shots}
    findings = []
    counts = frames["counts"].values
    read = frames["wavelength_read"].values
    for at in sorted(range(len(shots)), key=lambda at: (not shots[at].dark, shots[at].ordinal)):
        shot = shots[at]
        found = judge.judge(
            shot, counts[at], wavelength_read=float(read[at]), last_of_bracket=last[_key(shot)] == shot.ordinal
        )
        findings += [(shot, finding) for finding in found]
        if not any(finding.severity == "bad" for finding in found):
            judge.learn(shot, counts[at])
    return findings


def _shots(frames: xr.Dataset) -> Iterator[Shot]:
    names = ("shot", "purpose", "load", "side", "incidence", "wavelength", "nd_position", "exposure")
    none = np.full(frames.sizes["frame"], np.nan)
    aims = zip(*(frames[name].values if name in frames else none for name in ("aim_theta", "aim_phi")), strict=True)
    for aim, (ordinal, purpose, load, side, incidence, wavelength, position, exposure) in zip(
        aims, zip(*(frames[name].values.tolist() for name in names), strict=True), strict=True
    ):
        turned = None if np.isnan(aim[0]) else (float(aim[0]), float(aim[1]))
        arrangement = Arrangement(load, side, incidence, again=purpose == ETALON_AFTER, aim=turned)
        yield Shot(ordinal, purpose, arrangement, wavelength, position, exposure)


def _key(shot: Shot) -> tuple[str, Arrangement, float]:
    return shot.purpose, shot.arrangement, shot.wavelength


def relevant(frames: xr.Dataset, load: str, side: str, incidence: float) -> xr.Dataset:
    """The frames that a judgement of one arrangement needs: its own, and dark, target and lamp monitor frames of the whole run.

    With the monitor readings come the bracket frames of the same settings, which show whether arrangements differ.
    """
    purpose = frames["purpose"].values
    own = (purpose == load) & (frames["side"].values == side) & (frames["incidence"].values == incidence)
    wanted = own | np.isin(purpose, ("dark", "target", "drift"))
    names = ("wavelength", "nd_position", "exposure")
    settings = list(zip(*(frames[name].values.tolist() for name in names), strict=True))
    monitored = {settings[at] for at in np.flatnonzero(purpose == "drift")}
    repeated = np.array([setting in monitored for setting in settings]) & ~np.isin(purpose, ("dark", LINE_LAMP))
    # Of another arrangement one frame is as good as a monitor reading, and no complete bracket.
    as_monitor = np.where(repeated & ~wanted, "drift", purpose)
    return frames.assign_coords(purpose=("frame", as_monitor)).isel(frame=wanted | repeated)
