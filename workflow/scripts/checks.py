from brdfpipe import store
from brdfpipe.bsdf import checks


def main(input, output, params):
    """Reciprocity, energy and closure of a BRDF."""
    bsdf = store.shared_dataset(input["bsdf"], "bsdf")
    store.save_dataset(
        checks.check(bsdf), output["checks"], stage="checks", material=params["material"], inputs={"bsdf": bsdf}
    )


if __name__ == "__main__":
    from brdfpipe.jobs.stage import run_as_script

    run_as_script(main)
