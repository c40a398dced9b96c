from brdfpipe import store
from brdfpipe.bsdf import fitting
from brdfpipe.exchange import companions


def main(input, output, params):
    """The Lambert and Gauss parameters that come closest to a BRDF."""
    spec, bsdf = params["spec"], store.open_dataset(input["bsdf"], "bsdf")
    fit = store.save_dataset(
        fitting.fit_lambert_gauss(bsdf, spec["theta_i"]),
        output["lambert_gauss"],
        stage="lambert_gauss",
        material=params["material"],
        inputs={"bsdf": bsdf},
        parameters=spec,
    )
    companions.write_lambert_gauss(fit, output["csv"])


if __name__ == "__main__":
    from brdfpipe.jobs import by_hand

    by_hand(main)
