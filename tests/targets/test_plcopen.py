from __future__ import annotations

import re
from copy import deepcopy
from pathlib import Path
from typing import Any

import pytest

from shmgen import config
from shmgen.core.diagnostics import Report
from shmgen.generator import pipeline

from ..conftest import SHARED
from ..support import import_or_skip
from ..support.ide import Found, Ide, Reference
from .test_st import SIZES, members, parse

etree = import_or_skip("lxml.etree")
import_or_skip("blark")

PLC = "{http://www.plcopen.org/xml/tc6_0200}"
XHTML = "{http://www.w3.org/1999/xhtml}xhtml"
CODESYS = "http://www.3s-software.com/plcopenxml/"

HOSTILE = "]]> </xhtml></pou> &amp; &#0; <!-- \"quoted\" 'single' {attribute 'x'} <?pi?> \u0394\U0001f916"
MESSAGES = {
    "Point": "float64 x  # [m]\nfloat64 y\n",
    "Everything": f"# {HOSTILE}\nuint8 LEAST=0\nstring SIGN='a < b && c > \"d\" // ;'\nint64 LOW=-9223372036854775808\n"
    f"\nbool flag true  # {HOSTILE}\nint8 a\nuint16 b\nint64 c\nuint64 d\nfloat32 e 1.5\nfloat64[3] f\n"
    "string<=12 text '<&;//:= \\'\"'\nwstring<=5 wide \"]]>;\"\nstring<=7[<=2] names\nPoint[2] corners\n"
    "builtin_interfaces/Time stamp\n",
    "Empty": "",
}
TOML = """\
path = ["msgs"]
messages = ["demo_msgs"]
task_interval = 25
[[topics]]
topic = "/robot/everything"
type = "demo_msgs/Everything"
depth = 3
[[topics]]
topic = "/robot/point"
type = "demo_msgs/Point"
direction = "from_plc"
[[services]]
service = "/cell/start"
type = "demo_msgs/Start"
[[services]]
service = "/robot/stop"
type = "demo_msgs/srv/Start"
server = "ros"
[[actions]]
action = "/cell/move"
type = "demo_msgs/Move"
[[actions]]
action = "/robot/move"
type = "demo_msgs/action/Move"
server = "ros"
"""
CALLS = {
    "srv/Start.srv": "string<=8 order\n---\nbool success\n",
    "action/Move.action": "float64 x\n---\nfloat64 x\n---\nfloat64 x\n",
}


def generate(folder: Path, options: str = "", targets: str = '["st", "plcopen"]') -> dict[str, str]:
    (folder / "msgs" / "demo_msgs" / "msg").mkdir(parents=True, exist_ok=True)
    for name, text in MESSAGES.items():
        (folder / "msgs" / "demo_msgs" / "msg" / f"{name}.msg").write_text(text, encoding="utf-8")
    for path, text in CALLS.items():
        file = folder / "msgs" / "demo_msgs" / path
        file.parent.mkdir(exist_ok=True)
        file.write_text(text)
    (folder / "shmgen.toml").write_text(f"targets = {targets}\n{TOML}{options}")
    loaded = config.load(folder / "shmgen.toml", "shmgen.toml", Report())
    return pipeline.generate(loaded, loaded.messages)


@pytest.fixture(scope="module")
def texts(tmp_path_factory: pytest.TempPathFactory) -> dict[str, str]:
    return generate(tmp_path_factory.mktemp("plcopen"))


@pytest.fixture(scope="module")
def project(texts: dict[str, str]) -> Any:
    return etree.fromstring(texts["plcopen/shmgen.xml"].encode())


@pytest.fixture(scope="module")
def files(texts: dict[str, str]) -> dict[str, str]:
    """The generated Structured Text, by the name of its object."""
    return {Path(path).stem: text for path, text in texts.items() if path.startswith("st/")}


@pytest.fixture(scope="module")
def objects(project: Any) -> dict[str, Any]:
    """All objects that an import creates, by name."""
    return {item.get("name"): item for tag in ("dataType", "globalVars", "pou") for item in project.iter(PLC + tag)}


def data(item: Any, name: str) -> list[Any]:
    """Return the elements in the addData `name` of CODESYS, of `item` itself and not of its descendants."""
    return item.findall(f"{PLC}addData/{PLC}data[@name='{CODESYS}{name}']/*")


def plain(item: Any) -> str:
    return str(item.findtext(f"{PLC}InterfaceAsPlainText/{XHTML}") or data(item, "interfaceasplaintext")[0][0].text)


def body(item: Any) -> str:
    return item.findtext(f"{PLC}body/{PLC}ST/{XHTML}") or ""


# --- the format ---------------------------------------------------------------------------------------


@pytest.mark.parametrize("options", ["", '[types]\nbool = "BOOL"\ntime = "LTIME"\n', '[types]\ntime = "struct"\n'])
def test_xml_is_valid(tmp_path: Path, options: str) -> None:
    file = SHARED / "schemas" / "tc6_xml_v201.xsd"
    if not file.is_file():
        pytest.skip(f"no schema of PLCopen at {file}")
    # Only the schema of 2.0.1 is available. It contains all elements of 2.0 that shmgen uses.
    schema = etree.XMLSchema(etree.fromstring(file.read_bytes().replace(b"tc6_0201", b"tc6_0200")))
    project = etree.fromstring(generate(tmp_path, options)["plcopen/shmgen.xml"].encode())
    schema.assertValid(project)
    (resource,) = project.iter(PLC + "resource")
    for variables in list(project.iter(PLC + "globalVars")):
        # The schema ignores addData, so the test moves its content to the standard place.
        resource.find(PLC + "addData").addprevious(deepcopy(variables))
    configurations = project.find(f"{PLC}instances/{PLC}configurations")
    resource.getparent().getparent().remove(resource.getparent())
    etree.SubElement(configurations, PLC + "configuration", name="Device").append(resource)
    schema.assertValid(project)


def test_plcopen_package_of_pypi_reads_the_xml(texts: dict[str, str], files: dict[str, str]) -> None:
    plcopen = import_or_skip("plcopen")
    parsers = import_or_skip("xsdata.formats.dataclass.parsers")
    # The package rejects the `value` in an `arrayValue`, which the schema requires.
    xml = re.sub("<initialValue><arrayValue>.*?</initialValue>", "", texts["plcopen/shmgen.xml"])
    xml = xml.replace("tc6_0200", "tc6_0201")  # the version of the package
    read = parsers.XmlParser().from_bytes(xml.encode(), plcopen.Project)
    names = [item.name for item in (*read.types.data_types.data_type, *read.types.pous.pou)]
    assert sorted(names) == sorted(name for name in files if not name.startswith("GVL"))
    blocks = {pou.name: pou for pou in read.types.pous.pou}
    inputs = blocks["FB_demo_msgs_Point_Publisher"].interface.input_vars[0].variable
    assert [variable.name for variable in inputs] == ["xEnable", "sTopic", "xSend", "Msg", "udiDepth"]
    assert read.instances.configurations.configuration == []


def test_xml_is_reproducible(texts: dict[str, str], tmp_path: Path) -> None:
    xml = texts["plcopen/shmgen.xml"]
    assert generate(tmp_path)["plcopen/shmgen.xml"] == xml
    assert set(re.findall(r"\d{4}-\d\d-\d\d", xml)) == {"2000-01-01"}
    assert xml.isascii()


# --- the content ------------------------------------------------------------------------------------


def test_xml_contains_each_object_once(project: Any, files: dict[str, str]) -> None:
    names = [item.get("name") for tag in ("dataType", "globalVars", "pou") for item in project.iter(PLC + tag)]
    assert sorted(names) == sorted(files)


def test_plain_text_equals_the_text_of_the_files(objects: dict[str, Any], files: dict[str, str]) -> None:
    """Compare all lines, except empty lines and the END_ keywords, which an IDE does not store."""
    for name, text in files.items():
        item = objects[name]
        if item.tag != PLC + "pou":
            assert plain(item) + "\n" == text
            continue
        keyword = "PROGRAM" if item.get("pouType") == "program" else "FUNCTION_BLOCK"
        lines = [*plain(item).split("\n"), *body(item).split("\n"), f"END_{keyword}"]
        for method in data(item, "method"):
            lines += [*plain(method).split("\n"), *body(method).split("\n"), "END_METHOD"]
        assert [line for line in lines if line] == [line for line in text.split("\n") if line], name


def test_declaration_and_code_are_separate(objects: dict[str, Any]) -> None:
    block = objects["FB_demo_msgs_Point_Subscriber"]
    assert plain(block).startswith("// Reads demo_msgs/msg/Point from one topic.")
    assert plain(block).endswith("END_VAR")
    assert body(block).startswith("xNewData := FALSE;")
    methods = {method.get("name"): method for method in data(block, "method")}
    assert list(methods) == ["Init", "FB_Reinit", "Read", "ReadInto"]
    assert plain(methods["ReadInto"]).split("\n")[-7:] == [
        "METHOD PUBLIC ReadInto : BOOL",
        "VAR_INPUT",
        "    pTo   : POINTER TO ST_demo_msgs_Point;",
        "END_VAR",
        "VAR",
        "    pSlot : POINTER TO ST_demo_msgs_Point;",
        "END_VAR",
    ]
    assert body(methods["ReadInto"]).startswith("ReadInto := FALSE;\npSlot := _fbRegion.BeginRead")
    assert body(objects["FB_ShmRegion"]) == ""
    unlock = next(method for method in data(objects["FB_ShmRegion"], "method") if method.get("name") == "Unlock")
    assert plain(unlock).split("\n")[-1] == "METHOD PRIVATE Unlock"


def st_type(item: Any) -> str:
    """Return a type as Structured Text."""
    tag = item.tag.removeprefix(PLC)
    match tag:
        case "array":
            (dimension,) = item.findall(f"{PLC}dimension")
            inner = st_type(item.find(f"{PLC}baseType")[0])
            return f"ARRAY [{dimension.get('lower')}..{dimension.get('upper')}] OF {inner}"
        case "pointer":
            return f"POINTER TO {st_type(item.find(f'{PLC}baseType')[0])}"
        case "string" | "wstring":
            return f"{tag.upper()}({item.get('length')})"
        case "derived":
            assert item.get("name") == "LTIME" or item.get("name") not in SIZES, "PLCopen has an element for this type"
            return str(item.get("name"))
        case _:
            return str(tag)


def declarations(section: Any) -> list[tuple[str, str]]:
    """Return the names and the types, with initial values, of a section."""
    pairs = []
    for variable in section.findall(f"{PLC}variable"):
        value = variable.find(f"{PLC}initialValue/*")
        initial = "" if value is None else f" := {st_value(value)}"
        pairs.append((variable.get("name"), st_type(variable.find(f"{PLC}type")[0]) + initial))
    return pairs


def st_value(value: Any) -> str:
    if value.tag == f"{PLC}simpleValue":
        return str(value.get("value"))
    return f"[{', '.join(st_value(element[0]) for element in value.findall(f'{PLC}value'))}]"


SECTIONS = {
    "InputDeclarations": "inputVars",
    "OutputDeclarations": "outputVars",
    "VariableDeclarations": "localVars",
    "IncompleteLocatedVariableDeclarations": "localVars",  # blark's class of an empty VAR
}


@pytest.mark.exhaustive
def test_structured_declarations_match_blark(objects: dict[str, Any], files: dict[str, str]) -> None:
    for name, text in files.items():
        item = objects[name]
        if item.tag == PLC + "globalVars":
            assert declarations(item) == members(text)
            assert item.get("constant") == ("true" if "\nVAR_GLOBAL CONSTANT\n" in text else None)
        elif "\nSTRUCT\n" in text:
            assert declarations(item.find(f"{PLC}baseType/{PLC}struct")) == members(text)
        elif item.tag == PLC + "pou":
            unit, *methods = parse(text)
            for read, stored in zip([unit, *methods], [item, *data(item, "method")], strict=True):
                sections = stored.find(f"{PLC}interface").findall("*")
                sections = [section for section in sections if section.tag.endswith("Vars")]
                assert [section.tag for section in sections] == [
                    PLC + SECTIONS[type(section).__name__] for section in read.declarations
                ]
                for section, lists in zip(read.declarations, sections, strict=True):
                    expected = [
                        # blark changes the spelling of T#1s
                        (str(getattr(name, "variable", name)), re.sub(r"TIME#(\d+)S", r"T#\1s", str(item.init)))
                        for item in section.items
                        for name in item.variables
                    ]
                    assert declarations(lists) == expected, f"{name}.{stored.get('name')}"
                    assert lists.get("constant") == ("true" if section.attrs else None)
                returns = stored.find(f"{PLC}interface/{PLC}returnType")
                assert (None if returns is None else st_type(returns[0])) == (
                    str(read.return_type) if getattr(read, "return_type", None) else None
                )
        elif (struct := item.find(f"{PLC}baseType/{PLC}struct")) is not None:
            assert declarations(struct) == members(text)


def test_enumerations_keep_base_type_and_values(objects: dict[str, Any], files: dict[str, str]) -> None:
    for name in ("E_ShmError", "E_ShmState"):
        enum = objects[name].find(f"{PLC}baseType/{PLC}enum")
        values = [(value.get("name"), value.get("value")) for value in enum.iter(PLC + "value")]
        assert values == re.findall(r"^    (\w+) +:= (\d+)", files[name], re.MULTILINE)
        assert st_type(enum.find(f"{PLC}baseType")[0]) == "UDINT"
        first = objects[name].find(f"{PLC}initialValue/{PLC}simpleValue").get("value")
        assert first == values[0][0]


def test_attributes_match_the_files(objects: dict[str, Any], files: dict[str, str]) -> None:
    for name, item in objects.items():
        attributes = [attribute for lists in data(item, "attributes") for attribute in lists]
        stored = [(attribute.get("Name"), attribute.get("Value")) for attribute in attributes]
        expected = re.findall(r"^\{attribute '(\w+)'(?: := '(\w*)')?\}$", files[name], re.MULTILINE)
        assert stored == expected, name
    assert [tuple(a.attrib.values()) for a in data(objects["ST_ShmHeader"], "attributes")[0]] == [("pack_mode", "8")]


def test_private_methods_stay_private(objects: dict[str, Any], files: dict[str, str]) -> None:
    methods = data(objects["FB_ShmRegion"], "method")
    private = [method.get("name") for method in methods if data(method.find(f"{PLC}interface"), "accessmodifiers")]
    assert private == re.findall(r"^METHOD PRIVATE (\w+)", files["FB_ShmRegion"], re.MULTILINE)


def test_libraries_match_the_comment_of_the_block(project: Any, files: dict[str, str]) -> None:
    assert data(project, "libraries") == [], "exports store libraries in the application"
    (resource,) = data(project, "application")
    (libraries,) = data(resource, "libraries")
    (manager,) = project.iterfind(f".//{PLC}Object[@Name='Library Manager']")
    assert [node.text for node in data(libraries, "objectid")] == [manager.get("ObjectId")]
    libraries = libraries.findall(f"{PLC}Library")
    titles = [library.get("Name").lstrip("#").partition(",")[0] for library in libraries]
    assert f"// Libraries: {', '.join(titles)}." in files["FB_ShmRegion"]


def test_hostile_comments_stay_comments(objects: dict[str, Any], project: Any) -> None:
    everything = objects["ST_demo_msgs_Everything"]
    ascii_comment = HOSTILE.replace("\u0394", "<U+0394>").replace("\U0001f916", "<U+1F916>")
    assert everything.find(f"{PLC}documentation") is None, "one report says that an IDE rejects this file"
    assert ascii_comment in plain(everything)
    flag = everything.find(f".//{PLC}variable[@name='flag']/{PLC}documentation/{XHTML}")
    assert (flag.text, len(flag)) == (ascii_comment, 0)
    assert not list(project.iter(etree.Comment, etree.ProcessingInstruction))
    text = everything.find(f".//{PLC}variable[@name='text']/{PLC}initialValue/{PLC}simpleValue")
    assert text.get("value") == "'<&;//:= $'\"'"
    sign = objects["GVL_demo_msgs_Everything"].find(f".//{PLC}variable[@name='SIGN']//{PLC}simpleValue")
    assert sign.get("value") == "'a < b && c > \"d\" // ;'"


# --- the script ---------------------------------------------------------------------------------------


def test_script_is_python_2_7(texts: dict[str, str]) -> None:
    parso = import_or_skip("parso")
    if parso.__version__ >= "0.8":
        pytest.skip(f"parso {parso.__version__} has no grammar of Python 2.7; 0.7.1 is the last")
    grammar = parso.load_grammar(version="2.7")
    code = texts["plcopen/import_shmgen.py"]
    assert [issue.message for issue in grammar.iter_errors(grammar.parse(code))] == []
    assert code.isascii()
    newer = grammar.parse('say(f"{text}")\n')
    assert list(grammar.iter_errors(newer)), "the grammar must reject newer syntax"


@pytest.fixture
def script(texts: dict[str, str], tmp_path: Path) -> Path:
    for name in ("shmgen.xml", "import_shmgen.py"):
        (tmp_path / name).write_text(texts[f"plcopen/{name}"])
    return tmp_path / "import_shmgen.py"


SYSTEM = ("SysShm, 3.5.17.0 (System)", "SysSemProcess, 3.5.15.0 (System)", "SysTypes2 Interfaces, 3.5.17.0 (System)")


def test_script_imports_objects_and_keeps_those_of_the_user(
    script: Path, texts: dict[str, str], files: dict[str, str]
) -> None:
    own_objects = [Found("ST_demo_msgs_Point"), Found("PRG_Mine")]
    ide = Ide(SYSTEM, own_objects, references=[Reference("#SysShm", SYSTEM[0])])
    ide.run(script)
    application = ide.application
    assert ide.replaced == ["ST_demo_msgs_Point"]
    (folder,) = [child for child in application.children if child.is_folder]
    assert {child.name for child in application.children} >= {"ROS", "ST_demo_msgs_Point", "PRG_Mine"}
    assert [child.name for child in folder.children] == ["demo_msgs", "shmgen", "GVL_Ros", "PRG_Ros"]
    stems = [Path(path).stem for path in texts if path.startswith("st/demo_msgs/")]
    assert sorted([*(child.name for child in folder.children[0].children), "ST_demo_msgs_Point"]) == sorted(stems)
    assert [reference.name for reference in ide.manager.references] == ["#SysShm", "#SysSemProcess", SYSTEM[2]]
    ide.open_again()
    assert ide.build() == []
    assert ide.table() == [
        ("Information", "objects", f"{len(files) - 1} added, 1 replaced, 1 unchanged"),
        ("Information", "folder", "ROS"),
        ("Information", "library SysShm", "present"),
        ("Information", "library SysSemProcess", "added"),
        ("Information", "library SysTypes2 Interfaces", "added"),
        (
            "Information",
            "task RosTask",
            "added, calls PRG_Ros, interval t#25ms, priority 10; add your own program after it",
        ),
    ]
    (task,) = application.tasks.children
    task.pous.append("PRG_Mine")
    ide.run(script)
    assert sorted(ide.replaced[1:]) == sorted(files), "a second import replaces objects and creates no Pose_1"
    assert len(folder.children) == 4
    assert task.pous == ["PRG_Ros", "PRG_Mine"]
    assert [what for severity, what, _ in ide.table() if severity != "Information"] == []


def test_script_reports_missing_libraries(script: Path) -> None:
    """Warn if no library is installed, and if one of two libraries does not resolve."""
    ide = Ide(libraries=())
    ide.run(script)
    ide.open_again()
    manual_steps = [what for severity, what, done in ide.table() if severity == "Warning" and "by hand" in done]
    assert manual_steps == ["library SysShm", "library SysSemProcess", "library SysTypes2 Interfaces"]
    ide = Ide(SYSTEM, unresolved=("SysSemProcess",), references=[Reference("#SysShm", "")])
    ide.run(script)
    ide.open_again()
    assert [reference.name for reference in ide.manager.references] == ["#SysShm", SYSTEM[2]]
    assert ("Warning", "library SysSemProcess") in [row[:2] for row in ide.table()]


def test_script_adapts_to_other_ides(script: Path, files: dict[str, str]) -> None:
    """Support an IDE that imports the task, and an IDE without folders that requires priorities as text."""
    ide = Ide(SYSTEM, takes_task=True)
    ide.run(script)
    assert ("Information", "task RosTask", "present, unchanged") in ide.table()
    ide = Ide(SYSTEM, flat=True, priority=str)
    ide.run(script)
    (folder,) = [child for child in ide.application.children if child.is_folder]
    assert sorted(child.name for child in folder.children) == sorted(files)
    assert ide.build() == []


def test_simulated_ide_rejects_what_codesys_rejects(script: Path) -> None:
    """Prevent that the script passes although a real IDE would reject its calls."""
    ide = Ide(SYSTEM)
    ide.manager.add_library("Elsewhere")
    with pytest.raises(RuntimeError, match="placeholder library 'Elsewhere' could not be resolved"):
        ide.open_again()
    ide = Ide(SYSTEM)
    task = ide.application.create_task_configuration().create_task("Lost")
    task.priority = "10"
    assert ide.build() == ["The task priority is invalid"]
    xml = script.parent / "shmgen.xml"
    old = '<configurations><configuration name="Default"><resource name="R" /></configuration></configurations>'
    xml.write_text(xml.read_text().replace("<configurations />", old))
    reporter = ide.reporter()
    ide.application.import_xml(reporter, str(xml), True)
    assert "Object 'Default' is not accepted by parent object" in reporter.errors
    xml.write_text(xml.read_text().replace("tc6_0200", "tc6_0201"))
    with pytest.raises(ValueError, match="namespace"):
        ide.application.import_xml(reporter, str(xml), True)


def test_script_adds_no_task_without_topics(tmp_path: Path) -> None:
    (tmp_path / "shmgen.toml").write_text("")
    loaded = config.load(tmp_path / "shmgen.toml", "shmgen.toml", Report())
    code = pipeline.generate(loaded, ["std_msgs/Bool"])["plcopen/import_shmgen.py"]
    assert "RosTask" not in code
    compile(code, "import_shmgen.py", "exec")
