from brdfpipe import store
from brdfpipe.bsdf.input_uncertainty import uncertainty
from brdfpipe.comparison.error_as_uncertainty import gloss_error, relative_light_error


def main(input, output, params):
    """The changes of the predicted BSDF by the uncertainties of its inputs."""
    kinds = {"predicted": "bsdf", "wave": "bsdf"}
    inputs = {name: store.open_dataset(path, kinds.get(name, name)) for name, path in input.items()}
    given = {name: inputs[name] for name in ("facets", "psd", "index", "spectrum") if name in inputs}
    if (compared := inputs.get("model_error")) is not None:
        given |= {**relative_light_error(compared).data_vars, "gloss_error": gloss_error(compared)}
    result = uncertainty(inputs.get("wave", inputs.get("predicted")), **given)
    store.save_dataset(result, output["uncertainty"], stage="uncertainty", material=params["material"], inputs=inputs)


if __name__ == "__main__":
    from brdfpipe.jobs.stage import run_as_script

    run_as_script(main)
