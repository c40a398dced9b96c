from brdfpipe import store
from brdfpipe.bsdf.lambert_gauss_fit import fit_lambert_gauss
from brdfpipe.bsdf.registry import representation
from brdfpipe.exchange.sidecar_tables import write_lambert_gauss


def main(input, output, params):
    """The Lambert and Gauss parameters that fit a BRDF best; of a surface with a lay, for light along it."""
    spec, bsdf = params["spec"], store.shared_dataset(input["bsdf"], "bsdf")
    along = representation(bsdf).lay or 0.0
    fit = store.save_dataset(
        fit_lambert_gauss(bsdf, spec["theta_i"], along),
        output["lambert_gauss"],
        stage="lambert_gauss",
        material=params["material"],
        inputs={"bsdf": bsdf},
        parameters=spec,
    )
    turns = () if representation(bsdf).isotropic else (45.0, 90.0, 135.0)
    others = {along + turn: fit_lambert_gauss(bsdf, spec["theta_i"], along + turn) for turn in turns}
    write_lambert_gauss(fit, output["csv"], model=bsdf, azimuths={along: fit, **others} if turns else None)


if __name__ == "__main__":
    from brdfpipe.jobs.stage import run_as_script

    run_as_script(main)
