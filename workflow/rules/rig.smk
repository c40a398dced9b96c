# From runs of the camera rig, with the etalon and with the material, to a BSDF.


use rule stage_template as rig_run with:
    input:
        sources=pipeline.rig_sources,
        truth=pipeline.rig_truth,
    output:
        journal="{material}/run/journal.jsonl",


use rule stage_template as calibration_run with:
    input:
        sources=pipeline.rig_sources,
    output:
        journal="calibrations/{calibration}/run/journal.jsonl",


use rule stage_template as reduced with:
    input:
        journal=pipeline.rig_journal,
    output:
        reduced="{material}/reduced-{load}-{side}-{incidence}.nc",


use rule stage_template as calibration_reduced with:
    input:
        journal=pipeline.rig_journal,
    output:
        reduced="calibrations/{calibration}/reduced-{load}-{side}-{incidence}.nc",


use rule stage_template as calibration with:
    input:
        **results_of(reduced="calibration_reduced"),
        certificate=raw_file("certificate"),
        previous=pipeline.previous_calibration,
    output:
        calibration="calibrations/{calibration}.nc",


use rule stage_template as primary with:
    input:
        **results_of("reduced", "calibration", "index"),
    output:
        primary="{material}/primary-{side}.nc",


use rule stage_template as smoothed with:
    input:
        primary="{material}/primary-{side}.nc",
    output:
        smoothed="{material}/smoothed-{side}.nc",


use rule stage_template as measured with:
    input:
        **results_of("smoothed"),
    output:
        measured="{material}/measured.nc",


use rule stage_template as comparison with:
    input:
        **results_of(
            "predicted", "sheet", "coated", "wave", "facets", "index", "spectrum"
        ),
        primary="{material}/primary-reflection.nc",
    output:
        comparison="{material}/comparison.nc",
