"""``deepmf-sumo schema``: the JSON Schema of specs, and of messages to planners."""

import click


@click.command(name="schema", short_help="Print the JSON Schema of specs, for an editor.")
@click.option(
    "--planner", is_flag=True, help="Describe the messages to and from a planner program instead."
)
def command(planner: bool) -> None:
    """Print the JSON Schema of specs, for completion and checks in an editor.

    `deepmf-sumo schema > spec.schema.json` makes a file of it; name that in a spec's first line:
    # yaml-language-server: $schema=spec.schema.json
    """
    import json

    from deepmf_sumo import spec
    from deepmf_sumo.planners.remote import protocol

    schema = protocol.schema() if planner else spec.schema()
    click.echo(json.dumps(schema, indent=2, ensure_ascii=False))
