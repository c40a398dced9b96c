from brdfpipe import store
from brdfpipe.rig.reduction.arrangements import join_arrangements
from brdfpipe.rig.reduction.primary import apply_profile


def main(input, output, params):
    """The BSDF of each cell on one side of the sample, calibrated, with its uncertainty."""
    reduced = [store.open_dataset(path, "reduced") for path in input["reduced"]]
    profile = store.open_dataset(input["calibration"], "calibration")
    index = {name: store.open_dataset(path, name) for name, path in input.items() if name == "index"}
    store.save_dataset(
        apply_profile(join_arrangements(reduced), profile, **index, **params["spec"]),
        output["primary"],
        stage="primary",
        material=params["material"],
        inputs={f"reduced-{number}": dataset for number, dataset in enumerate(reduced)}
        | {"calibration": profile}
        | index,
        parameters=params["spec"],
    )


if __name__ == "__main__":
    from brdfpipe.jobs.stage import run_as_script

    run_as_script(main)
