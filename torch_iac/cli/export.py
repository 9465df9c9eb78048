"""The command `torch-iac export`."""

from torch_iac.cli.commands import Export
from torch_iac.runs.reader import load_run


def export(asked: Export) -> None:
    """Run `torch-iac export`.

    Raises:
        FileNotFoundError: The folder holds no run.
        ValueError: Nothing is asked for, a name or the robot is refused, a library is missing, or
            the world does not come out as recorded.
    """
    run = load_run(asked.run_folder)
    if asked.rerun is None and asked.minari is None:
        raise ValueError("export needs a target: --rerun FILE.rrd, --minari NAME or both")
    if asked.rerun is not None:
        from torch_iac.export.rerun_file import save_rerun

        print(save_rerun(run, asked.rerun, asked.agent))  # noqa: T201 - the command's answer
    if asked.minari is not None:
        from torch_iac.export.minari_data import save_minari

        print(save_minari(run, asked.minari))  # noqa: T201 - the command's answer
