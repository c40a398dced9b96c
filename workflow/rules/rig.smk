# From a run of the camera rig to a BSDF: the calibration's run and the material's, reduced arrangement by arrangement.


rule rig_run:
    input:
        sources=stages.rig_sources,
        truth=stages.rig_truth,
    output:
        journal="{material}/run/journal.jsonl",
    log:
        "logs/{material}/rig_run.log",
    params:
        spec=stages.rig_spec("rig_run"),
        code=stages.code("rig_run"),
    message:
        "rig_run of {wildcards.material}"
    run:
        stages.run(rule, wildcards, input, output, params)


rule calibration_run:
    input:
        sources=stages.rig_sources,
    output:
        journal="calibrations/{calibration}/run/journal.jsonl",
    log:
        "logs/calibrations.{calibration}/rig_run.log",
    params:
        spec=stages.rig_spec("rig_run"),
        code=stages.code("rig_run"),
    message:
        "rig_run of calibration {wildcards.calibration}"
    run:
        stages.run("rig_run", wildcards, input, output, params)


rule reduced:
    input:
        journal=stages.rig_journal,
    output:
        reduced="{material}/reduced-{load}-{side}-{incidence}.nc",
    log:
        "logs/{material}/reduced-{load}-{side}-{incidence}.log",
    wildcard_constraints:
        load="sample|etalon",
        side="reflection|transmission",
        incidence=r"[0-9.]+",
    params:
        spec=stages.rig_spec("reduced"),
        code=stages.code("reduced"),
    message:
        "reduced {wildcards.load} at {wildcards.incidence} degree, {wildcards.side}, of {wildcards.material}"
    run:
        stages.run(
            f"reduced-{wildcards.load}-{wildcards.side}-{wildcards.incidence}",
            wildcards,
            input,
            output,
            params,
            script="reduced",
        )


use rule reduced as calibration_reduced with:
    output:
        reduced="calibrations/{calibration}/reduced-{load}-{side}-{incidence}.nc",
    log:
        "logs/calibrations.{calibration}/reduced-{load}-{side}-{incidence}.log",
    message:
        "reduced {wildcards.load} at {wildcards.incidence} degree of calibration {wildcards.calibration}"


rule calibration:
    input:
        reduced=stages.reduced("etalon"),
        certificate=stages.certificate,
        previous=stages.previous,
    output:
        calibration="calibrations/{calibration}.nc",
    log:
        "logs/calibrations.{calibration}/calibration.log",
    wildcard_constraints:
        calibration="[A-Za-z0-9][A-Za-z0-9._-]*",
    params:
        spec=stages.rig_spec("calibration"),
        code=stages.code("calibration"),
    message:
        "calibration {wildcards.calibration}"
    run:
        stages.run(rule, wildcards, input, output, params)


rule primary:
    input:
        reduced=stages.reduced("sample"),
        calibration=stages.calibration_of,
    output:
        primary="{material}/primary-{side}.nc",
    log:
        "logs/{material}/primary-{side}.log",
    wildcard_constraints:
        side="reflection|transmission",
    params:
        spec=stages.spec("primary"),
        code=stages.code("primary"),
    message:
        "primary, {wildcards.side}, of {wildcards.material}"
    run:
        stages.run(
            f"primary-{wildcards.side}",
            wildcards,
            input,
            output,
            params,
            script="primary",
        )


rule smoothed:
    input:
        primary="{material}/primary-{side}.nc",
    output:
        smoothed="{material}/smoothed-{side}.nc",
    log:
        "logs/{material}/smoothed-{side}.log",
    wildcard_constraints:
        side="reflection|transmission",
    params:
        spec=stages.spec("smoothed"),
        code=stages.code("smoothed"),
    message:
        "smoothed, {wildcards.side}, of {wildcards.material}"
    run:
        stages.run(
            f"smoothed-{wildcards.side}",
            wildcards,
            input,
            output,
            params,
            script="smoothed",
        )


rule measured:
    input:
        smoothed=stages.by_side("smoothed"),
    output:
        measured="{material}/measured.nc",
    log:
        "logs/{material}/measured.log",
    params:
        spec=stages.spec("measured"),
        code=stages.code("measured"),
    message:
        "measured of {wildcards.material}"
    run:
        stages.run(rule, wildcards, input, output, params)


rule comparison:
    input:
        primary="{material}/primary-reflection.nc",
        predicted="{material}/predicted.nc",
        facets="{material}/facets.nc",
        index="{material}/index.nc",
        spectrum=branch(stages.has("spectrum"), then="{material}/spectrum.nc"),
    output:
        comparison="{material}/comparison.nc",
    log:
        "logs/{material}/comparison.log",
    params:
        spec=stages.spec("comparison"),
        code=stages.code("comparison"),
    message:
        "comparison of {wildcards.material}"
    run:
        stages.run(rule, wildcards, input, output, params)
