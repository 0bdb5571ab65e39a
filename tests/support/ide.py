"""A replacement for the script engine of the CODESYS IDE, as strict as public records describe the real one.

An attribute that no record mentions raises an error. Arguments of Ide choose the behaviour where IDEs differ or the
records leave it open. Passing these tests does not prove that a script works in CODESYS.
"""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from pathlib import Path
from types import SimpleNamespace
from typing import Any

from lxml import etree

PLC = "{http://www.plcopen.org/xml/tc6_0200}"
DATA = "http://www.3s-software.com/plcopenxml/"


class Found:
    """An object, a folder, or a task configuration in the tree of the project."""

    is_folder = is_task = is_task_configuration = False

    def __init__(self, name: str, children: Sequence[Found] = ()) -> None:
        self.name, self.children, self.parent = name, [], None
        for child in children:
            self.take(child)

    def take(self, child: Found) -> None:
        child.parent = self
        self.children.append(child)

    def get_name(self) -> str:
        return self.name

    def get_children(self, recursive: bool) -> tuple[Found, ...]:
        return tuple(self.walk()) if recursive else tuple(self.children)

    def walk(self) -> Iterator[Found]:
        for child in self.children:
            yield child
            yield from child.walk()

    def move(self, new_parent: Found) -> None:
        assert self.parent
        self.parent.children.remove(self)
        new_parent.take(self)


class Folder(Found):
    is_folder = True


class Task(Found):
    """A task. `priority` accepts the type that the IDE requires, and silently ignores other types."""

    is_task = True

    def __init__(self, name: str, kind: type) -> None:
        super().__init__(name)
        self._kind, self._priority, self.interval, self.pous = kind, None, "", Pous()

    @property
    def priority(self) -> Any:
        return self._priority

    @priority.setter
    def priority(self, value: Any) -> None:
        self._priority = str(value) if type(value) is self._kind else None


class Pous(list[str]):
    def add(self, name: str) -> None:
        self.append(name)


class Tasks(Found):
    is_task_configuration = True

    def __init__(self, kind: type) -> None:
        super().__init__("Task Configuration")
        self.kind = kind

    def create_task(self, name: str) -> Task:
        task = Task(name, self.kind)
        self.take(task)
        return task


class Reference:
    """A reference of the Library Manager. A placeholder's name begins with #; `effective_resolution` may be empty."""

    def __init__(self, name: str, effective_resolution: str = "") -> None:
        self.name, self.is_placeholder = name, name.startswith("#")
        if self.is_placeholder:
            self.effective_resolution = effective_resolution


class Managed(str):
    """An installed library, by its display name."""


class Manager:
    """The Library Manager of the application."""

    def __init__(self, references: Sequence[Reference], unresolved: Sequence[str]) -> None:
        self.references, self.unresolved = list(references), unresolved

    def add_library(self, library: str) -> None:
        """Add a library. A string always adds a placeholder, even for an installed library."""
        self.references.append(Reference(library if isinstance(library, Managed) else f"#{library}"))

    def add_placeholder(self, name: str, library: Managed) -> None:
        assert isinstance(library, Managed)
        self.references.append(Reference(f"#{name}", "" if name in self.unresolved else library))

    def remove_library(self, name: str) -> None:
        (reference,) = [it for it in self.references if it.name == name]
        self.references.remove(reference)


class ImportReporter:
    """The base class of reporters. The engine rejects any other reporter."""


class Application(Found):
    """The application that scripts import into. `tasks` is its task configuration, if any."""

    def __init__(self, ide: Ide, children: Sequence[Found]) -> None:
        super().__init__("Application", children)
        self.ide = ide

    @property
    def tasks(self) -> Any:
        return next((child for child in self.children if child.is_task_configuration), None)

    def create_folder(self, name: str) -> None:
        self.take(Folder(name))

    def create_task_configuration(self) -> Tasks:
        tasks = Tasks(self.ide.priority)
        self.take(tasks)
        return tasks

    def get_library_manager(self) -> Manager:
        return self.ide.manager

    def import_xml(self, reporter: Any, path: str, import_folder_structure: bool) -> None:
        assert isinstance(reporter, ImportReporter)
        root = etree.parse(path).getroot()
        if root.tag != PLC + "project":
            raise ValueError(f"not of the schema: namespace {etree.QName(root).namespace}")
        for configuration in root.iter(PLC + "configuration"):
            reporter.error(f"Object '{configuration.get('name')}' is not accepted by parent object")
        for item in root.iter(PLC + "dataType", PLC + "pou", PLC + "globalVars"):
            self._import(item.get("name"), reporter)
        if import_folder_structure and not self.ide.flat:
            self._arrange(root.find(f"{PLC}addData/{PLC}data[@name='{DATA}projectstructure']/*"), self)
        for resource in root.iterfind(f"{PLC}addData/{PLC}data[@name='{DATA}application']/{PLC}resource"):
            self._resource(resource, reporter)

    def _import(self, name: str, reporter: Any) -> None:
        existing = next((it for it in self.walk() if it.name == name and not it.is_folder), None)
        if existing is None:
            existing = Found(name)
            self.take(existing)
            self.ide.new.append(existing)
            reporter.added(existing)
        elif reporter.resolve_conflict(existing) == "Replace":
            self.ide.replaced.append(name)
            reporter.replaced(existing)
        else:
            reporter.skipped(name)

    def _arrange(self, level: Any, parent: Found) -> None:
        """Move new objects into folders. Existing objects keep their place."""
        for item in level:
            if item.tag == PLC + "Folder":
                folder = next((it for it in parent.children if it.is_folder and it.name == item.get("Name")), None)
                if folder is None:
                    folder = Folder(item.get("Name"))
                    parent.take(folder)
                self._arrange(item, folder)
            else:
                for child in [it for it in self.ide.new if it.name == item.get("Name")]:
                    child.move(parent)
                    self.ide.new.remove(child)

    def _resource(self, resource: Any, reporter: Any) -> None:
        """Import a resource, which must name the existing application."""
        if reporter.resolve_conflict(self) == "Skip":
            reporter.skipped(self.name)
        if not self.ide.takes_task:
            reporter.error("Object 'RosTask' is not accepted by parent object")
            return
        tasks = self.tasks or self.create_task_configuration()
        for item in resource.iter(PLC + "task"):
            if not any(task.name == item.get("name") for task in tasks.children):
                task = tasks.create_task(item.get("name"))
                task.priority = self.ide.priority(item.get("priority"))
                task.pous.extend(it.get("name") for it in item.iter(PLC + "pouInstance"))


class Ide:
    """An IDE with one project. `libraries` are installed; placeholders of `unresolved` get no resolution.

    `priority` is the type of a task's priority. If `flat`, an import creates no folders. If `takes_task`, it adds the
    task.
    """

    def __init__(
        self,
        libraries: Sequence[str],
        children: Sequence[Found] = (),
        *,
        references: Sequence[Reference] = (),
        unresolved: Sequence[str] = (),
        priority: type = int,
        flat: bool = False,
        takes_task: bool = False,
    ) -> None:
        self.libraries = [Managed(library) for library in libraries]
        self.manager = Manager(references, unresolved)
        self.priority, self.flat, self.takes_task = priority, flat, takes_task
        self.application = Application(self, children)
        self.new: list[Found] = []
        self.replaced: list[str] = []
        self.messages: list[tuple[str, str]] = []

    def run(self, script: Path) -> None:
        """Run a script as *Execute Script File* does."""
        self.messages.clear()
        exec(compile(script.read_text(), str(script), "exec"), self._scope(script))

    def reporter(self) -> Any:
        """Return a reporter that stores its calls and replaces existing objects."""

        class Reporter(ImportReporter):
            errors: list[str] = []  # noqa: RUF012
            error = errors.append
            resolve_conflict = staticmethod(lambda obj: "Replace")
            added = replaced = skipped = staticmethod(lambda item: None)

        return Reporter()

    def table(self) -> list[tuple[str, str, str]]:
        """Return the messages of the script: severity, object and result."""
        rows = []
        for severity, text in self.messages:
            what, _, done = text.removeprefix("shmgen: ").partition("  ")
            rows.append((severity, what, done.strip()))
        return rows

    def open_again(self) -> None:
        """Close the project and open it again."""
        for reference in self.manager.references:
            if reference.is_placeholder and not reference.effective_resolution:
                raise RuntimeError(f"The placeholder library '{reference.name[1:]}' could not be resolved.")

    def build(self) -> list[str]:
        """Return the errors of the compiler."""
        tasks = self.application.tasks
        return ["The task priority is invalid" for task in tasks.children if task.priority is None] if tasks else []

    def _scope(self, script: Path) -> dict[str, Any]:
        return {
            "__name__": "__main__",
            "__file__": str(script),
            "ImportReporter": ImportReporter,
            "ConflictResolve": SimpleNamespace(Replace="Replace", Skip="Skip", Copy="Copy"),
            "Severity": SimpleNamespace(Error="Error", Warning="Warning", Information="Information"),
            "system": SimpleNamespace(write_message=lambda severity, text: self.messages.append((severity, text))),
            "projects": SimpleNamespace(primary=SimpleNamespace(active_application=self.application)),
            "librarymanager": SimpleNamespace(find_library=self._find, get_all_libraries=lambda flat: self.libraries),
        }

    def _find(self, display_name: str) -> tuple[Managed, object] | None:
        """Find a library by its whole display name. A * matches no version, because no record shows that it does."""
        return next(((it, None) for it in self.libraries if it == display_name), None)
