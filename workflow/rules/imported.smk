# From a table of another program or instrument to a BSDF.


use rule stage_template as imported with:
    input:
        raw=raw_file("table"),
    output:
        imported="{material}/imported.nc",
