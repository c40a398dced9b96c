from brdfpipe import store
from brdfpipe.comparison.readings import compare_readings, readings_table


def main(input, output, params):
    """Readings of instruments beside what the BSDF predicts of them."""
    spec, bsdf = params["spec"], store.shared_dataset(input["bsdf"], "bsdf")
    readings = store.save_dataset(
        compare_readings(bsdf, spec["measured"], spec.get("fitted", ())),
        output["readings"],
        stage="readings",
        material=params["material"],
        inputs={"bsdf": bsdf},
        parameters=spec,
    )
    store.write_text(output["csv"], readings_table(readings))


if __name__ == "__main__":
    from brdfpipe.jobs.stage import run_as_script

    run_as_script(main)
