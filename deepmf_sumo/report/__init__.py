"""Result folder -> pages, pictures and tables.

It decides nothing: a number on a page is a number of the folder, with the words of
`results.quantities`. The page is one file that opens without a network: it is mailed, and it is
kept as an artefact of CI. Pictures are drawn from rollouts, so that a run looks alike on a page, in
a figure and in documentation.
"""
