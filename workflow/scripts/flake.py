from brdfpipe import store
from brdfpipe.bsdf import flake


def main(input, output, params):
    """The BRDF of a paint with effect pigments, fitted along the flake angle."""
    multiangle = store.open_dataset(input["multiangle"], "multiangle")
    store.save_dataset(
        flake.build(multiangle, **params["spec"]),
        output["flake"],
        stage="flake",
        material=params["material"],
        inputs={"multiangle": multiangle},
        parameters=params["spec"],
    )


if __name__ == "__main__":
    from brdfpipe.jobs.stage import run_as_script

    run_as_script(main)
