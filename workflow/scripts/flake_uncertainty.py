from brdfpipe import store
from brdfpipe.bsdf.flake_uncertainty import uncertainty


def main(input, output, params):
    """The changes of the BSDF of an effect paint by the uncertainties of its colours, its clear coat and its fit."""
    multiangle = store.open_dataset(input["multiangle"], "multiangle")
    flake = store.open_dataset(input["flake"], "bsdf")
    store.save_dataset(
        uncertainty(flake, multiangle, **params["spec"]),
        output["flake_uncertainty"],
        stage="flake_uncertainty",
        material=params["material"],
        inputs={"multiangle": multiangle, "flake": flake},
        parameters=params["spec"],
    )


if __name__ == "__main__":
    from brdfpipe.jobs.stage import run_as_script

    run_as_script(main)
