"""The commands for live regions."""

from __future__ import annotations

import functools
import sys
import time

import click

from shmgen.cli import common, options


@click.command()
@click.argument("topic", required=False, shell_complete=common.topics)
@common.json_option
@options.source_options
@common.report_errors
def doctor(topic: str | None, as_json: bool, source: options.Source) -> None:
    """Find faults in the shared memory of topics, and print remedies.

    A region is the shared memory of one topic. The command checks the owner, mode, writer, lock, semaphore, layout and
    depth of all regions, or of TOPIC. The layout and depth of each region must match shmgen.toml and
    generated/layout.lock in the current folder. The command also reports 32-bit processes that share a region with
    64-bit processes, and processes that still use a removed region. The exit code is 1 if the command finds a fault.
    """
    from shmgen.tools.doctor import doctor as tool
    from shmgen.tools.messages import format

    report = tool.examine(topic, common.registry(source))
    click.echo(format.as_line(tool.plain(report), indent=2) if as_json else tool.text(report))
    sys.exit(0 if report.healthy else 1)


@click.command()
@click.argument("topics", nargs=-1, metavar="[TOPIC]...", shell_complete=common.topics)
@click.option(
    "--all", "everything", is_flag=True, help="Remove all regions, and incomplete semaphores of killed processes."
)
@click.option(
    "--force",
    is_flag=True,
    help="Also remove regions in use. Processes that use a removed region exchange no samples with new processes.",
)
@click.option("--dry-run", is_flag=True, help="Print the files to remove, and remove nothing.")
@common.report_errors
def clean(topics: tuple[str, ...], everything: bool, force: bool, dry_run: bool) -> None:
    """Remove the shared memory and semaphores of topics from /dev/shm.

    If a process uses a region, the command keeps this region and exits with 1.
    """
    from shmgen.live import processes, regions
    from shmgen.runtime import RegionMissing, ShmError
    from shmgen.tools.doctor import clean as tool

    if everything == bool(topics):
        raise click.UsageError("Give topics or --all; `shmgen doctor` lists the existing topics.")
    around = processes.look()

    def leftovers(topic: str) -> list[str]:
        files = tool.leftovers(topic)
        if not force and (why := tool.in_use(topic, around)):
            hint = f"stop it first; `shmgen clean --force {topic}` removes the files while they are in use"
            raise ShmError(f"{topic}: {why}\n  hint: {hint}")
        return files

    chosen = (
        [regions.topic_of(name) for name in regions.live()]
        if everything
        else [half for topic in topics for half in regions.resolve_topic(topic)]
    )
    finds = [functools.partial(leftovers, topic) for topic in chosen]
    if everything:
        finds.append(functools.partial(tool.orphan_semaphores, around))
    stays = False
    for find in finds:
        try:
            files = find()
            if not dry_run:
                tool.remove(files)
        except ShmError as error:
            if everything and isinstance(error, RegionMissing):  # its owner has removed it meanwhile
                continue
            options.print_diagnostics([common.diagnostic(error)])
            stays = True
        else:
            for file in files:
                click.echo(f"{'would remove' if dry_run else 'removed'} {file}")
    sys.exit(1 if stays else 0)


@click.command()
@common.topic
@click.option("--once", is_flag=True, help="Print the newest sample, or wait for the first sample, and exit.")
@common.count("samples")
@common.timeout
@common.json_option
@click.option("--csv", "as_csv", is_flag=True, help="Print CSV with a line of field names.")
@click.option(
    "--field",
    metavar="PATH",
    shell_complete=common.fields,
    help="Print only this field, such as pose.position.x or points[2].",
)
@click.option("--filter", "only", metavar="CONDITION", help="Print only samples that match, such as position.x > 1.")
@click.option("-f", "--full", is_flag=True, help="Print all elements of arrays, not only the first 32.")
@options.source_options
@common.report_errors
def echo(
    topic: str,
    once: bool,
    count: int | None,
    timeout: float | None,
    as_json: bool,
    as_csv: bool,
    field: str | None,
    only: str | None,
    full: bool,
    source: options.Source,
) -> None:
    """Print the samples of a topic as YAML, JSON or CSV.

    The command needs no generated code, because the shared memory contains the name of the type. The command finds your
    own message definitions in the folders given with -I, and in the key `path` of shmgen.toml. Bounds come from
    shmgen.toml or generated/layout.lock. If the topic does not exist yet, the command waits. If a sequence in a sample
    has more elements than its bound, the command reports an error and exits with 1.
    """
    from shmgen.runtime import CountExceeded, RegionUnusable
    from shmgen.tools.messages import echo as tool
    from shmgen.tools.messages import stream

    if as_json and as_csv:
        raise click.UsageError("--json or --csv, not both.")
    messages = stream.messages(topic, common.registry(source), timeout, common.note)
    refused = False
    count_printed = 0
    printer = tool.Printer("json" if as_json else "csv" if as_csv else "yaml", field, only, full)
    try:
        for message in messages:
            try:
                text = printer.text(message)
            except CountExceeded as error:
                options.print_diagnostics([common.diagnostic(RegionUnusable(f"{topic}: damaged sample: {error}"))])
                refused = True
            else:
                if text is None:
                    continue
                click.echo(text)
            count_printed += 1
            if count_printed == (1 if once else count):
                break
    finally:
        messages.close()
    sys.exit(int(refused))


@click.command(context_settings={"ignore_unknown_options": True})
@common.topic
@click.argument("type_name", metavar="TYPE", shell_complete=common.types)
@click.argument("values", default="{}", metavar="[VALUES]")
@click.option("-r", "--rate", type=click.FloatRange(0.001, 10000), default=1.0, show_default=True, help="Rate in Hz.")
@click.option("--once", is_flag=True, help="Publish one sample, which stays readable after the command ends.")
@common.count("samples")
@options.source_options
@common.report_errors
def pub(
    topic: str, type_name: str, values: str, rate: float, once: bool, count: int | None, source: options.Source
) -> None:
    """Publish VALUES, in YAML or JSON, on a topic.

    Omitted fields get their default values. A field of a time type may have the value `now`.

    \b
    Publish ten samples a second:
    shmgen pub /robot/pose geometry_msgs/Pose '{position: {x: 1.0}}' -r 10
    """  # noqa: D301 click's own sign
    from shmgen.tools.messages import parse
    from shmgen.tools.messages import pub as tool

    data = parse.parse(values)
    samples = tool.publish(topic, type_name, data, common.registry(source), rate, 1 if once else count)
    for number, message in enumerate(samples, start=1):
        click.echo(f"publishing #{number}: {message}")


@click.command(context_settings={"ignore_unknown_options": True})
@click.argument("service", shell_complete=common.services)
@click.argument("type_name", metavar="TYPE", shell_complete=common.types)
@click.argument("values", default="{}", metavar="[VALUES]")
@click.option(
    "--timeout",
    type=click.FloatRange(0),
    default=5.0,
    show_default=True,
    help="Exit with 1 after this many seconds without a response.",
)
@common.json_option
@options.source_options
@common.report_errors
def call(service: str, type_name: str, values: str, timeout: float, as_json: bool, source: options.Source) -> None:
    """Call a service, and print the response.

    \b
    Call a service with the request `data: true`:
    shmgen call /cell/start std_srvs/SetBool '{data: true}'

    VALUES is the request, in YAML or JSON. If the server has not started yet, the command waits. A service has one
    client at a time, so the command fails if the PLC or a bridge is the client.
    """  # noqa: D301 click's own sign
    from shmgen.tools.messages import call as tool
    from shmgen.tools.messages import format, parse

    request, kind = tool.build(service, type_name, parse.parse(values), common.registry(source))
    with kind(service) as client:
        if not as_json:
            click.echo(f"requesting: {request}")
        response = client.call(request, timeout)
        click.echo(format.as_json(response) if as_json else format.yaml(response, None), nl=as_json)


@click.command()
@click.option(
    "-d", "--delay", type=click.FloatRange(0.1), default=1.0, show_default=True, help="Seconds between updates."
)
@click.option("--once", is_flag=True, help="Print one table, and exit.")
@common.count("tables")
@common.json_option
@common.report_errors
def top(delay: float, once: bool, count: int | None, as_json: bool) -> None:
    """Show all topics in shared memory in a live table.

    The columns include each topic's writer, rate and missed samples, and the age of the newest sample. Press q to quit,
    s to sort by the next column, and r to reverse the order. If the output is a pipe, the command prints one table
    after the other.
    """
    from shmgen.live.regions import unlisted
    from shmgen.tools.messages.format import as_line
    from shmgen.tools.watch import overview as tool
    from shmgen.tools.watch import screen

    number = 1 if once else count
    if common.can_draw() and number is None and not as_json:
        screen.run(delay)
        return
    past: tool.Past = {}
    widths: dict[str, int] = {}
    if hidden_reason := unlisted(tool.look(past)):
        common.note(hidden_reason)
    count_printed = 0
    while count_printed != number:
        time.sleep(delay)
        rows = tool.ordered(tool.look(past), "topic", reverse=False)
        count_printed += 1
        if as_json:
            click.echo(as_line([row.plain((*tool.COLUMNS, "size")) for row in rows]))
        else:
            click.echo(
                "\n".join([*tool.table(rows, "", widths_before=widths), *([] if count_printed == number else [""])])
            )


COMMANDS = (doctor, clean, echo, pub, call, top)
