"""The init command."""

import subprocess
import sys

from click.testing import CliRunner

from deepmf_sumo.cli.init import command


def test_says_what_was_written_and_what_to_do_next(tmp_path):
    result = CliRunner().invoke(command, [str(tmp_path / "play")])
    assert result.exit_code == 0, result.output
    assert "specs among them" in result.output
    assert "deepmf-sumo run scenarios/*.yaml" in result.output
    assert (tmp_path / "play" / "scenarios" / "cut_in.yaml").is_file()


def test_importing_the_command_is_cheap():
    code = (
        "import sys, deepmf_sumo.cli.init; "
        "print([m for m in ('torch', 'libsumo', 'matplotlib', 'pandas') if m in sys.modules])"
    )
    done = subprocess.run([sys.executable, "-c", code], capture_output=True, text=True, check=True)
    assert done.stdout.strip() == "[]"
