from pathlib import Path

from brdfpipe import store
from brdfpipe.rig.reduction.arrangements import join_arrangements
from brdfpipe.rig.reduction.calibration import calibrate
from brdfpipe.rig.reduction.certificate import Certificate
from brdfpipe.rig.reduction.control_chart import extend_chart


def main(input, output, params):
    """The calibration profile of a rig, from the light of the etalon in each cell and its certificate; with its control chart."""
    reduced = [store.open_dataset(path, "reduced") for path in input["reduced"]]
    certificate = Path(input["certificate"])
    inputs = {f"reduced-{number}": dataset for number, dataset in enumerate(reduced)} | {"certificate": certificate}
    name = params["material"].partition(".")[2]  # of calibrations.NAME
    profile = calibrate(join_arrangements(reduced), Certificate.load(certificate), name=name, **params["spec"])
    if "previous" in input:
        inputs["previous"] = store.open_dataset(input["previous"], "calibration")
        profile = extend_chart(profile, inputs["previous"])
    store.save_dataset(
        profile,
        output["calibration"],
        stage="calibration",
        material=params["material"],
        inputs=inputs,
        parameters=params["spec"],
    )


if __name__ == "__main__":
    from brdfpipe.jobs.stage import run_as_script

    run_as_script(main)
