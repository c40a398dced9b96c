from brdfpipe import store
from brdfpipe.comparison.reading_fit import with_fit
from brdfpipe.comparison.readings import compare_readings, readings_table


def main(input, output, params):
    """Readings of instruments beside what the BSDF predicts of them, and the inputs that would make them agree."""
    spec, bsdf = params["spec"], store.shared_dataset(input["bsdf"], "bsdf")
    kinds = {"predicted": "bsdf"}
    inputs = {name: store.open_dataset(path, kinds.get(name, name)) for name, path in input.items() if name != "bsdf"}
    compared = compare_readings(bsdf, spec["measured"], spec.get("fitted", ()))
    readings = store.save_dataset(
        with_fit(compared, spec["measured"], bsdf, **inputs, **spec["doubtful"]),
        output["readings"],
        stage="readings",
        material=params["material"],
        inputs={"bsdf": bsdf, **inputs},
        parameters=spec,
    )
    store.write_text(output["csv"], readings_table(readings))


if __name__ == "__main__":
    from brdfpipe.jobs.stage import run_as_script

    run_as_script(main)
