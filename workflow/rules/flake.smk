# From colours at several geometries to a BSDF: effect pigments.


rule multiangle:
    input:
        raw=stages.raw("multiangle"),
    output:
        multiangle="{material}/multiangle.nc",
    log:
        "logs/{material}/multiangle.log",
    params:
        spec=stages.spec("multiangle"),
        code=stages.code("multiangle"),
    message:
        "multiangle of {wildcards.material}"
    run:
        stages.run(rule, wildcards, input, output, params)


rule flake:
    input:
        multiangle="{material}/multiangle.nc",
    output:
        flake="{material}/flake.nc",
    log:
        "logs/{material}/flake.log",
    params:
        spec=stages.spec("flake"),
        code=stages.code("flake"),
    message:
        "flake of {wildcards.material}"
    run:
        stages.run(rule, wildcards, input, output, params)
