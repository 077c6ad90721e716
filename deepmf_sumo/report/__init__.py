"""Result folder -> pages, pictures and tables.

It decides nothing: a number on a page is a number of the folder, with the words of
`results.quantities`; only rates of the rows that a reader chooses are counted on the page. The page
is one file that opens without a network: it is mailed, and it is kept as an artefact of CI.
Pictures are drawn from rollouts, so that a run looks alike on a page, in a figure and in
documentation.

The page's table, charts and map are 29 kB of its own script. Leaflet (162 kB), uPlot (51 kB) and a
library of tables would make each page three times as large as that of one run is now, and what
draws roads, road users and plans on a canvas would stay. There is one template, and what is put
into it is data: it needs no engine.
"""
