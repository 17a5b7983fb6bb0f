"""docs/equations.md and the code: what the page names exists, and what the code cites is on the page."""

import ast
import pathlib
import re

ROOT = pathlib.Path(__file__).resolve().parents[1]
PAGE = ROOT / "docs" / "equations.md"
TEXT = PAGE.read_text(encoding="utf-8")
# [file.py](../file.py) `function`, `Class.method`
PLACE = re.compile(r"\]\((\.\./[^)#]+)\)((?:,?(?: inverse)? `[\w.]+`)*)")
CITED_ERRATA = re.compile(r"[Ee]rrat(?:a|um) (\d+b?(?:(?:,| and| to) \d+b?)*)")
CITED_DEFECT = re.compile(r"\bD-\d+\b")
SOURCES = (".py", ".cpp", ".hpp", ".launch", ".test", ".xml", ".yaml", ".msg", ".cfg", ".md", "")


def names_in(path):
    """Classes, functions, `Class.method` and constants that a Python file defines."""
    found = set()
    for node in ast.parse(path.read_text(encoding="utf-8")).body:
        if isinstance(node, ast.Assign):
            found.update(target.id for target in node.targets if isinstance(target, ast.Name))
        elif isinstance(node, (ast.FunctionDef, ast.ClassDef)):
            found.add(node.name)
        if isinstance(node, ast.ClassDef):
            found.update("%s.%s" % (node.name, part.name) for part in node.body if isinstance(part, ast.FunctionDef))
    return found


def rows(heading):
    """First cells of the tables under a heading."""
    section = re.search(r"^## %s$(.*?)(?=^## |\Z)" % re.escape(heading), TEXT, re.MULTILINE | re.DOTALL).group(1)
    return [cell for cell in re.findall(r"^\| ([^|]*?) \|", section, re.MULTILINE) if cell not in ("No.", "Equation")]


def expanded(text):
    """Numbers that a text lists: "7.8 to 7.10, 7.12" are 7.8, 7.9, 7.10, 7.12; "24 and 25b" are 24, 25b."""
    found = []
    for part in re.split(r", | and ", text):
        first, _, last = part.partition(" to ")
        found.append(first)
        if last:
            chapter, _, number = first.rpartition(".")
            steps = range(int(number) + 1, int(last.rpartition(".")[2]) + 1)
            found += ["%s.%d" % (chapter, step) if chapter else str(step) for step in steps]
    return found


def cited(pattern):
    """{what the code cites: a file that does}"""
    found = {}
    for folder in ("src", "launch", "tests"):
        for path in (ROOT / folder).rglob("*"):
            if path.suffix in SOURCES and path.is_file() and path != pathlib.Path(__file__):
                for match in pattern.findall(path.read_text(encoding="utf-8", errors="ignore")):
                    found.setdefault(match, str(path.relative_to(ROOT)))
    return found


def test_every_numbered_equation_has_one_row():
    last = {4: 3, 5: 5, 6: 4, 7: 28}
    wanted = ["%d.%d" % (chapter, n) for chapter, count in last.items() for n in range(1, count + 1)] + ["D.1"]
    headings = re.findall(r"^## (.*\(chapter \d\)|Appendices.*)$", TEXT, re.MULTILINE)
    found = [number for heading in headings for cell in rows(heading) for number in expanded(cell)]
    assert [number for number in found if "." in number] == wanted


def test_every_file_and_function_exists():
    places = PLACE.findall(TEXT)
    missing = []
    for link, names in places:
        path = PAGE.parent / link
        if not path.is_file():
            missing.append(link)
            continue
        known = names_in(path) if path.suffix == ".py" else ()
        missing += ["%s %s" % (link, name) for name in re.findall(r"`([\w.]+)`", names) if name not in known]
    assert len(places) > 25
    assert not missing


def test_every_misprint_that_the_code_cites_is_listed():
    citations = cited(CITED_ERRATA)
    assert {"24", "6, 7"} <= set(citations), "the pattern finds what is known to be there"
    listed = rows("Misprints")
    assert len(set(listed)) == len(listed)
    assert {text: where for text, where in citations.items() if not set(expanded(text)) <= set(listed)} == {}
    assert [text for text in CITED_ERRATA.findall(TEXT) if not set(expanded(text)) <= set(listed)] == []


def test_every_defect_that_the_code_cites_is_listed():
    citations = cited(CITED_DEFECT)
    assert {"D-25", "D-27"} <= set(citations)
    listed = rows("Defects of the original release")
    assert len(set(listed)) == len(listed)
    assert {text: where for text, where in citations.items() if text not in listed} == {}
