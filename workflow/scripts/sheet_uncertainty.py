from brdfpipe import store
from brdfpipe.bsdf.slab.input_uncertainty import uncertainty


def main(input, output, params):
    """The changes of the BSDF of a clear body by the uncertainties of its inputs."""
    kinds = {name: "bsdf" if name == "sheet" else name.removeprefix("back_") for name, _ in input.items()}
    inputs = {name: store.open_dataset(path, kinds[name]) for name, path in input.items()}
    given = {name: dataset for name, dataset in inputs.items() if name != "sheet"}
    result = uncertainty(inputs["sheet"], **given)
    target = output["sheet_uncertainty"]
    store.save_dataset(result, target, stage="sheet_uncertainty", material=params["material"], inputs=inputs)


if __name__ == "__main__":
    from brdfpipe.jobs.stage import run_as_script

    run_as_script(main)
