from brdfpipe import store
from brdfpipe.bsdf import tabulation
from brdfpipe.bsdf.nonspectral import nonspectral


def main(input, output, params):
    """The non-spectral BSDF on the grid of directions of the configuration."""
    spec, bsdf = params["spec"], store.shared_dataset(input["bsdf"], "bsdf")
    grid = tabulation.grid_for(bsdf, spec)
    make = tabulation.faithful_table if spec["refine"] else tabulation.tabulate
    store.save_dataset(
        make(nonspectral(bsdf), grid),
        output["table"],
        stage="table",
        material=params["material"],
        inputs={"bsdf": bsdf},
        parameters=spec,
    )


if __name__ == "__main__":
    from brdfpipe.jobs.stage import run_as_script

    run_as_script(main)
