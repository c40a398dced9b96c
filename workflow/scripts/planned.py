from brdfpipe import store
from brdfpipe.scenes.candidate_model import build
from brdfpipe.scenes.model_inputs import ModelInputs
from brdfpipe.scenes.planning import chosen_candidate


def main(input, output, params):
    """The BSDF of the model that was planned for a scene."""
    inputs = {name: store.open_dataset(path, name) for name, path in input.items()}
    given = {name: dataset for name, dataset in inputs.items() if name != "plan"}
    plan = inputs["plan"]
    bsdf = build(chosen_candidate(plan), ModelInputs(**given), plan.attrs["numerics"])
    store.save_dataset(
        bsdf.assign_attrs(route="predicted"),
        output["bsdf"],
        stage="planned",
        material=params["material"],
        inputs=inputs,
    )


if __name__ == "__main__":
    from brdfpipe.jobs.stage import run_as_script

    run_as_script(main)
