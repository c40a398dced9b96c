from brdfpipe import store
from brdfpipe.bsdf import checks


def main(input, output, params):
    """Reciprocity, energy and closure of a BRDF, and its mirrored light beside that of two spectra."""
    inputs = {"bsdf": store.shared_dataset(input["bsdf"], "bsdf")}
    if "spectrum" in input:
        inputs["spectrum"] = store.open_dataset(input["spectrum"], "spectrum")
    store.save_dataset(
        checks.check(**inputs), output["checks"], stage="checks", material=params["material"], inputs=inputs
    )


if __name__ == "__main__":
    from brdfpipe.jobs.stage import run_as_script

    run_as_script(main)
