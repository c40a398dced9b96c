from pathlib import Path

from brdfpipe import store
from brdfpipe.rig.calibration import Certificate, calibrate, joined


def main(input, output, params):
    """The calibration profile of a rig: from the etalon's light in each cell to a BRDF, by its certificate."""
    reduced = [store.open_dataset(path, "reduced") for path in input["reduced"]]
    store.save_dataset(
        calibrate(joined(reduced), Certificate.load(Path(input["certificate"])), **params["spec"]),
        output["calibration"],
        stage="calibration",
        material=params["material"],
        inputs={f"reduced-{place}": each for place, each in enumerate(reduced)} | {"certificate": input["certificate"]},
        parameters=params["spec"],
    )


if __name__ == "__main__":
    from brdfpipe.jobs import by_hand

    by_hand(main)
