from pathlib import Path

from brdfpipe.bsdf.accessor import open_dataset
from brdfpipe.rig.emulator import emulated_scan


def main(input, output, params):
    """A run that the emulated rig makes in place of a laboratory, of a material of which the BSDF is known, or of the etalon."""
    truth = open_dataset(input["truth"], "bsdf") if "truth" in input else None
    told = {key: value for key, value in params["spec"]["emulate"].items() if key != "truth"}
    emulated_scan.make_run(Path(input["sources"][0]), Path(output["journal"]).parent, truth, **told)


if __name__ == "__main__":
    from brdfpipe.jobs.stage import run_as_script

    run_as_script(main)
