"""``deepmf-sumo schema``: the JSON Schema of specs, and of messages to planners."""

from pathlib import Path

import click


@click.command(name="schema", short_help="Print the JSON Schema of specs, for an editor.")
@click.option(
    "--out",
    type=click.Path(dir_okay=False, path_type=Path),
    help="Write the schema to this file instead of the screen.",
)
@click.option(
    "--planner", is_flag=True, help="Describe the messages to and from a planner program instead."
)
def command(out: Path | None, planner: bool) -> None:
    """Print the JSON Schema of specs, for completion and checks in an editor.

    Name the file in a spec's first line: # yaml-language-server: $schema=spec.schema.json
    """
    import json

    from deepmf_sumo import files, spec
    from deepmf_sumo.planners.remote import protocol

    schema = protocol.schema() if planner else spec.schema()
    text = json.dumps(schema, indent=2, ensure_ascii=False) + "\n"
    if out is None:
        click.echo(text, nl=False)
        return
    with files.writing(out):
        files.write(out, text)
