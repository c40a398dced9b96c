from brdfpipe import store
from brdfpipe.bsdf.tabulation import table_for


def main(input, output, params):
    """The BSDF on the grid of directions of the configuration, where and at which wavelengths the scene needs it."""
    spec, bsdf = params["spec"], store.shared_dataset(input["bsdf"], "bsdf")
    store.save_dataset(
        table_for(bsdf, spec),
        output["table"],
        stage="table",
        material=params["material"],
        inputs={"bsdf": bsdf},
        parameters=spec,
    )


if __name__ == "__main__":
    from brdfpipe.jobs.stage import run_as_script

    run_as_script(main)
