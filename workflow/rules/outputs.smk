# From a BRDF to what people ask of it: checks, appearance, table, fit, exports, report.


rule bsdf:
    input:
        predicted="{material}/predicted.nc",
    output:
        bsdf="{material}/bsdf.nc",
    log:
        "logs/{material}/bsdf.log",
    params:
        spec=stages.spec("bsdf"),
        code=stages.code("bsdf"),
    message:
        "bsdf of {wildcards.material}"
    run:
        stages.run(rule, wildcards, input, output, params)


rule checks:
    input:
        bsdf="{material}/bsdf.nc",
    output:
        checks="{material}/checks.nc",
    log:
        "logs/{material}/checks.log",
    params:
        spec=stages.spec("checks"),
        code=stages.code("checks"),
    message:
        "checks of {wildcards.material}"
    run:
        stages.run(rule, wildcards, input, output, params)


rule appearance:
    input:
        bsdf="{material}/bsdf.nc",
    output:
        appearance="{material}/appearance.nc",
    log:
        "logs/{material}/appearance.log",
    params:
        spec=stages.spec("appearance"),
        code=stages.code("appearance"),
    message:
        "appearance of {wildcards.material}"
    run:
        stages.run(rule, wildcards, input, output, params)


rule table:
    input:
        bsdf="{material}/bsdf.nc",
    output:
        table="{material}/table.nc",
    log:
        "logs/{material}/table.log",
    params:
        spec=stages.spec("table"),
        code=stages.code("table"),
    message:
        "table of {wildcards.material}"
    run:
        stages.run(rule, wildcards, input, output, params)


rule lambert_gauss:
    input:
        bsdf="{material}/bsdf.nc",
    output:
        lambert_gauss="{material}/lambert_gauss.nc",
        csv="{material}/exports/{material}.lambert_gauss.csv",
    log:
        "logs/{material}/lambert_gauss.log",
    params:
        spec=stages.spec("lambert_gauss"),
        code=stages.code("lambert_gauss"),
    message:
        "lambert_gauss of {wildcards.material}"
    run:
        stages.run(rule, wildcards, input, output, params)


rule export_astm:
    input:
        table="{material}/table.nc",
        bsdf="{material}/bsdf.nc",
    output:
        astm="{material}/exports/{material}.astm",
        total_reflectance="{material}/exports/{material}.total_reflectance.csv",
    log:
        "logs/{material}/export_astm.log",
    params:
        spec=stages.spec("export_astm"),
        code=stages.code("export_astm"),
    message:
        "export_astm of {wildcards.material}"
    run:
        stages.run(rule, wildcards, input, output, params)


rule report:
    input:
        surface=branch(stages.measured("surface"), then="{material}/surface.nc"),
        facets=branch(stages.has("surface"), then="{material}/facets.nc"),
        masking=branch(stages.validates_masking, then="{material}/masking.nc"),
        index=branch(stages.has("index"), then="{material}/index.nc"),
        spectrum=branch(stages.has("spectrum"), then="{material}/spectrum.nc"),
        predicted="{material}/predicted.nc",
        bsdf="{material}/bsdf.nc",
        checks="{material}/checks.nc",
        appearance="{material}/appearance.nc",
        table="{material}/table.nc",
        lambert_gauss="{material}/lambert_gauss.nc",
    output:
        page="{material}/report.html",
        summary="{material}/summary.nc",
    log:
        "logs/{material}/report.log",
    params:
        spec=stages.spec("report"),
        code=stages.code("report"),
    message:
        "report of {wildcards.material}"
    run:
        stages.run(rule, wildcards, input, output, params)
