# From what a laboratory measured to a BRDF: surface, facets, index, spectrum, microfacet model.


rule surface:
    input:
        raw=stages.raw("surface"),
    output:
        surface="{material}/surface.nc",
    log:
        "logs/{material}/surface.log",
    params:
        spec=stages.spec("surface"),
        code=stages.code("surface"),
    message:
        "surface of {wildcards.material}"
    run:
        stages.run(rule, wildcards, input, output, params)


rule scan:
    input:
        raw=stages.raw_scan,
    output:
        surface="{material}/surface-{scan}.nc",
    log:
        "logs/{material}/surface-{scan}.log",
    wildcard_constraints:
        scan=r"\d+",
    params:
        spec=stages.scan_spec,
        code=stages.code("surface"),
    message:
        "scan {wildcards.scan} of {wildcards.material}"
    run:
        stages.run(
            f"surface-{wildcards.scan}",
            wildcards,
            input,
            output,
            params,
            script="surface",
        )


rule facets:
    input:
        surface=branch(stages.measured("surface"), then="{material}/surface.nc"),
        scans=stages.scans,
    output:
        facets="{material}/facets.nc",
    log:
        "logs/{material}/facets.log",
    params:
        spec=stages.spec("facets"),
        code=stages.code("facets"),
    message:
        "facets of {wildcards.material}"
    run:
        stages.run(rule, wildcards, input, output, params)


rule masking:
    input:
        surface="{material}/surface.nc",
        facets="{material}/facets.nc",
    output:
        masking="{material}/masking.nc",
    log:
        "logs/{material}/masking.log",
    params:
        spec=stages.spec("masking"),
        code=stages.code("masking"),
    message:
        "masking of {wildcards.material}"
    run:
        stages.run(rule, wildcards, input, output, params)


rule index:
    input:
        raw=stages.raw("index"),
    output:
        index="{material}/index.nc",
    log:
        "logs/{material}/index.log",
    params:
        spec=stages.spec("index"),
        code=stages.code("index"),
    message:
        "index of {wildcards.material}"
    run:
        stages.run(rule, wildcards, input, output, params)


rule spectrum:
    input:
        raw=stages.raw("spectrum"),
        index=branch(stages.has("index"), then="{material}/index.nc"),
    output:
        spectrum="{material}/spectrum.nc",
    log:
        "logs/{material}/spectrum.log",
    params:
        spec=stages.spec("spectrum"),
        code=stages.code("spectrum"),
    message:
        "spectrum of {wildcards.material}"
    run:
        stages.run(rule, wildcards, input, output, params)


rule predicted:
    input:
        facets=branch(stages.has("surface"), then="{material}/facets.nc"),
        index=branch(stages.has("index"), then="{material}/index.nc"),
        spectrum=branch(stages.has("spectrum"), then="{material}/spectrum.nc"),
    output:
        predicted="{material}/predicted.nc",
    log:
        "logs/{material}/predicted.log",
    params:
        spec=stages.spec("predicted"),
        code=stages.code("predicted"),
    message:
        "predicted of {wildcards.material}"
    run:
        stages.run(rule, wildcards, input, output, params)
