# From what a laboratory measured to a BSDF: surface, facets, index, spectrum, microfacet model; of a clear body, both its faces.


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


rule back_surface:
    input:
        raw=stages.raw("back_surface"),
    output:
        surface="{material}/back_surface.nc",
    log:
        "logs/{material}/back_surface.log",
    params:
        spec=stages.spec("back_surface"),
        code=stages.code("back_surface"),
    message:
        "back_surface of {wildcards.material}"
    run:
        stages.run(rule, wildcards, input, output, params)


rule back_facets:
    input:
        surface=branch(
            stages.measured("back_surface"), then="{material}/back_surface.nc"
        ),
    output:
        facets="{material}/back_facets.nc",
    log:
        "logs/{material}/back_facets.log",
    params:
        spec=stages.spec("back_facets"),
        code=stages.code("facets"),
    message:
        "back_facets of {wildcards.material}"
    run:
        stages.run(rule, wildcards, input, output, params, script="facets")


rule interior:
    input:
        raw=stages.raw("interior"),
    output:
        interior="{material}/interior.nc",
    log:
        "logs/{material}/interior.log",
    params:
        spec=stages.spec("interior"),
        code=stages.code("interior"),
    message:
        "interior of {wildcards.material}"
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
        back_facets=branch(stages.has("back"), then="{material}/back_facets.nc"),
        interior=branch(stages.has("slab"), then="{material}/interior.nc"),
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
