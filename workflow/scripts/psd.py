from brdfpipe import store
from brdfpipe.psd.analytic_spectra import analytic
from brdfpipe.psd.joining import estimate_joined


def main(input, output, params):
    """Roughness spectrum of a surface: of its scans, joined, or of an assumed Gaussian finish of its slope and correlation length."""
    spec, paths = params["spec"], [input["surface"], *input.get("scan", [])] if "surface" in input else []
    scans = {f"surface-{k}": store.open_dataset(path, "surface") for k, path in enumerate(paths, start=1)}
    if scans:
        result = estimate_joined(list(scans.values()), **spec)
    else:  # of the autocovariance σ² exp(−r²/ℓ²) the rms slope √⟨p² + q²⟩ is 2σ/ℓ
        result = analytic("gaussian", sigma=spec["slope_rms"] * spec["length"] / 2, length=spec["length"])
    store.save_dataset(result, output["psd"], stage="psd", material=params["material"], inputs=scans, parameters=spec)


if __name__ == "__main__":
    from brdfpipe.jobs.stage import run_as_script

    run_as_script(main)
