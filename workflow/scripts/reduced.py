from pathlib import Path

from brdfpipe import store
from brdfpipe.rig import frames
from brdfpipe.rig.plan import PLAN, Plan
from brdfpipe.rig.reduction.relative_light import reduce


def main(input, output, params):
    """The light of each cell relative to the reference, from the frames of one arrangement."""
    folder, spec = Path(input["journal"]).parent, params["spec"]
    run = frames.read_run(folder, spec["incidence"])
    rig = Plan.load(folder / PLAN).rig
    store.save_dataset(
        reduce(run, rig, **spec),
        output["reduced"],
        stage="reduced",
        material=params["material"],
        inputs={"frames": run},
        parameters=spec,
    )


if __name__ == "__main__":
    from brdfpipe.jobs.stage import run_as_script

    run_as_script(main)
