from brdfpipe import store
from brdfpipe.psd.analytic_spectra import analytic


def main(input, output, params):
    """Roughness spectrum of an assumed finish: a Gaussian one of its slope and correlation length."""
    spec = params["spec"]
    # Of the autocovariance σ² exp(−r²/ℓ²) the rms slope √⟨p² + q²⟩ is 2σ/ℓ.
    result = analytic("gaussian", sigma=spec["slope_rms"] * spec["length"] / 2, length=spec["length"])
    store.save_dataset(result, output["psd"], stage="psd", material=params["material"], inputs={}, parameters=spec)


if __name__ == "__main__":
    from brdfpipe.jobs.stage import run_as_script

    run_as_script(main)
