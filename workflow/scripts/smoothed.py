from brdfpipe import store
from brdfpipe.bsdf.measured.smoothing import smooth


def main(input, output, params):
    """The values of the cells, smoothed incidence by incidence, with the covariance of the fit."""
    primary = store.open_dataset(input["primary"], "primary")
    spec = params["spec"]["smoothing"]
    store.save_dataset(
        smooth(primary, **spec),
        output["smoothed"],
        stage="smoothed",
        material=params["material"],
        inputs={"primary": primary},
        parameters=spec,
    )


if __name__ == "__main__":
    from brdfpipe.jobs.stage import run_as_script

    run_as_script(main)
