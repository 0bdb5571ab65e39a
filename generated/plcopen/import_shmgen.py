# -*- coding: utf-8 -*-
"""Imports shmgen.xml, which lies beside this script, into the active application of the project open in CODESYS.

Tools > Scripting > Execute Script File. What an earlier import brought is replaced; nothing else is touched.
Then the libraries and the task are added where they are missing. The script saves nothing.

For the ScriptEngine of the IDE, which is IronPython 2.7.
"""
from __future__ import print_function

import io
import os
import re
import sys

HERE = os.path.dirname(os.path.abspath(globals().get("__file__") or sys.argv[0]))
FILE = os.path.join(HERE, "shmgen.xml")
LIBRARIES = (
    "SysShm, * (System)",
    "SysSemProcess, * (System)",
    "SysTypes Interfaces, * (System)",
)
TASK = "RosTask"
PROGRAM = "PRG_Ros"
INTERVAL = "t#10ms"
PRIORITY = "10"


def say(severity, text):
    system.write_message(severity, "shmgen: " + text)


class Reporter(ImportReporter):
    """Without one that answers Replace, the IDE would import a second Pose as Pose_1."""

    def __init__(self, ours):
        self.ours = ours
        self.counts = {"added": 0, "replaced": 0, "skipped": 0, "errors": 0}

    def resolve_conflict(self, obj):
        # A device or an application of the same name is the user's: to replace it would delete his work.
        return ConflictResolve.Replace if obj.get_name() in self.ours else ConflictResolve.Skip

    def error(self, message):
        self.counts["errors"] += 1
        say(Severity.Error, message)

    def warning(self, message):
        say(Severity.Warning, message)

    def added(self, obj):
        self.counts["added"] += 1

    def replaced(self, obj):
        self.counts["replaced"] += 1

    def skipped(self, name):
        self.counts["skipped"] += 1

    @property
    def aborting(self):
        return False


def names_in(path):
    """The data types, lists, blocks, programs and methods that the file brings."""
    with io.open(path, encoding="utf-8") as stream:
        return set(re.findall(r'<(?:dataType|globalVars|pou|Method) name="([^"]+)"', stream.read()))


def add_libraries(application):
    manager = application.get_library_manager()
    present = [str(library) for library in manager.get_libraries(False)]
    for library in LIBRARIES:
        title = library.partition(",")[0]
        if not any(name.lstrip("#").partition(",")[0] == title for name in present):
            try:
                manager.add_library(library)
                say(Severity.Information, "library " + library + " added")
            except Exception as error:
                say(Severity.Warning, "add " + library + " in the Library Manager by hand: " + str(error))


def add_task(application):
    """One that is there stays as it is: it may call programs of the user by now."""
    objects = application.get_children(True)
    if any(found.is_task and found.get_name() == TASK for found in objects):
        return
    settings = [found for found in objects if found.is_task_configuration]
    task = (settings[0] if settings else application.create_task_configuration()).create_task(TASK)
    task.pous.add(PROGRAM)
    task.interval = INTERVAL
    task.priority = PRIORITY
    say(Severity.Information, "task " + TASK + " added, which calls " + PROGRAM + "; add your own program after it")


def main():
    project = projects.primary
    application = project.active_application if project else None
    if application is None:
        system.ui.error("shmgen: open a project with an application first")
        return
    reporter = Reporter(names_in(FILE))
    application.import_xml(reporter, FILE, False)
    for step in (add_libraries, add_task):
        try:
            step(application)
        except Exception as error:
            say(Severity.Warning, step.__name__ + " did not work, do it by hand: " + str(error))
    counts = reporter.counts
    text = "%(added)d objects added, %(replaced)d replaced, %(skipped)d skipped, %(errors)d errors" % counts
    say(Severity.Error if counts["errors"] else Severity.Information, text)


main()
