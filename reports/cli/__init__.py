"""The commands, from compare, judge and furnace to bench and stress.

Exit status 0: ran; 1: an error was proven (BIASED or NOT AS PREDICTED against `own`; of `diff`, something became
worse; of `stress`, a row failed); 2: bad input, or a run, or one of its scenes, that could not end. With --json one
object goes to standard output, all else to standard error.
"""

import importlib.metadata
import sys

import cyclopts

from termwise import lacking
from termwise.reports.cli import engines, exchange, judging, measuring, places, rendering, runs, terminal


def _line(error: cyclopts.CycloptsError) -> str:
    """What is wrong with the command line, in a line."""
    text = " ".join(str(error).split())
    if isinstance(error, cyclopts.MissingArgumentError) and error.argument and error.tokens_so_far:
        wanted, _ = error.argument.token_count()
        text = f"{error.argument.name} = {' '.join(error.tokens_so_far)}: allowed are {wanted} values"
    return f"termwise: {text}"


app = cyclopts.App(
    name="termwise",
    help="The rendering equation term by term: is an estimator biased, by how much, where, and how sure are you?",
    error_console=terminal.messages,
    error_formatter=_line,
    version=lambda: importlib.metadata.version("termwise"),
    print_error=True,
    exit_on_error=False,
    suppress_keyboard_interrupt=False,
)
bench = cyclopts.App(name="bench", help="Measure speed beside Mitsuba's, both in one run.")
app.command(bench)
for command in (
    runs.compare,
    runs.diff,
    runs.figure,
    judging.judge,
    engines.furnace,
    places.inspect,
    places.replay,
    rendering.render,
    rendering.reference,
    rendering.plan,
    rendering.scenes,
    exchange.export,
    rendering.view,
    measuring.stress,
):
    app.command(command)
for command in (measuring.rays, measuring.terms, measuring.scaling, measuring.reductions):
    bench.command(command)
bench.command(measuring.bench_view, name="view")


def main() -> None:
    """Run the command; every foreseeable fault is one line on standard error and exit status 2."""
    from termwise.reference.backend import BackendError

    try:
        status = app(sys.argv[1:], exit_on_error=False)
    except cyclopts.CycloptsError:
        status = 2  # already printed, in one line
    except KeyboardInterrupt:
        terminal.fail("interrupted: nothing is half-written; a study goes on from the replicates it has finished")
        status = 2
    except ModuleNotFoundError as error:
        terminal.fail(lacking(error))
        status = 2
    except OSError as error:
        # NumPy says how much of an array it wrote, without a file or a number for the error.
        why = error.strerror or f"a file was cut short ({error}): is the disk full?"
        terminal.fail(f"{error.filename or 'writing'}: {why}")
        status = 2
    except (ValueError, BackendError) as error:
        terminal.fail(str(error))
        status = 2
    sys.exit(status)
