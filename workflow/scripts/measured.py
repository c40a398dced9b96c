from brdfpipe import store
from brdfpipe.bsdf.measured.completion import complete


def main(input, output, params):
    """The BSDF that a rig measured, for all directions."""
    sides = [store.open_dataset(path, "smoothed") for path in input["smoothed"]]
    store.save_dataset(
        complete(*sides, **params["spec"]),
        output["measured"],
        stage="measured",
        material=params["material"],
        inputs={f"smoothed-{side.attrs['side']}": side for side in sides},
        parameters=params["spec"],
    )


if __name__ == "__main__":
    from brdfpipe.jobs.stage import run_as_script

    run_as_script(main)
