"""The documentation site: `sphinx-build -W docs site`.

Pages are the Markdown files here. The notebooks are executed, the page of the commands is made from
their parser, and the API reference from the docstrings of the public names; none of these is kept.
"""

import contextlib
import inspect
import re
import shutil
import tempfile
from importlib import import_module
from pathlib import Path

from docutils.nodes import SkipNode
from latex2mathml.converter import convert

import greybox as gb
from greybox.cli.main import GROUPS, parser_of

HERE = Path(__file__).parent
project = "greybox"
copyright = "the greybox authors"
version = release = gb.__version__
extensions = [
    "myst_nb",
    "sphinx.ext.autodoc",
    "sphinx.ext.napoleon",
    "sphinx.ext.viewcode",
    "sphinx_copybutton",
]
exclude_patterns = ["jupyter_execute"]
html_math_renderer = "mathml"  # browsers draw it without a script from the network
myst_enable_extensions = ["deflist", "dollarmath"]
myst_heading_anchors = 3
nb_execution_mode = "force"  # the stored outputs are for forges; the build shows that cells run
nb_execution_timeout = 600
nb_execution_raise_on_error = True
nb_execution_show_tb = True
nb_merge_streams = True
autodoc_member_order = "bysource"
autodoc_typehints = "none"  # the docstrings give shapes and units, which types do not
napoleon_use_rtype = False
toc_object_entries = False
default_role = "code"
suppress_warnings = ["ref.python"]  # an attribute that several classes have is no link
html_theme = "pydata_sphinx_theme"
html_title = "greybox"
html_theme_options = {
    "header_links_before_dropdown": 7,
    "navbar_align": "left",
    # The printed answers of notebooks and the gallery need the width.
    "secondary_sidebar_items": {key: ["page-toc"] for key in ("[!g]*", "api/*", "guide/*")},
    "show_prev_next": False,
    "show_toc_level": 2,
}
html_static_path = ["style.css"]
html_css_files = ["style.css"]
html_show_sourcelink = False
html_sidebars = {"commands": [], "gallery": []}  # they have no pages below them


# The reference by task. A folder adds those of its public names that no task lists.
TASKS = {
    "Declare a model": "Parameter TransferFunction StateSpace feedback frequency_response "
    "structural_identifiability Integrator RungeKutta Radau modeling",
    "Write its formulas": "exp log sqrt sin cos tan tanh arcsin arccos arctan arctan2 sign maximum "
    "minimum where",
    "Read logs and tables": "read prepare Record data logs",
    "Measure a response": "FrequencyResponse read_response spectral",
    "State a problem": "Problem several RelativeError SquaredRelativeError RelativeLikelihood "
    "MaximumLikelihood MagnitudePhase OutputError PredictionError EquationError Criterion "
    "TimeCriterion formulation",
    "Fit it": "fit Fit cost objective Objective Solver Solution Starts Transcription "
    "MultipleShooting SingleShooting Collocation identify solve regression identification",
    "Judge the answer": "Evidence Finding misfit profile Profiles bootstrap Bootstrap compare "
    "simulate predict stepwise validation simulation",
    "Show it and hand it on": "draws Draws plot report save load plotting interop",
    "Fit many problems": "batch study",
    "Fly, plan and control": "virtual_flight Controller margins safe_gains experiment",
}


def public(module):
    """Return the public classes and functions of a module, in order of the alphabet."""
    names = (name for name in dir(module) if not name.startswith("_"))
    return [
        n
        for n in names
        if inspect.isclass(getattr(module, n)) or inspect.isroutine(getattr(module, n))
    ]


def names_of(task):
    """Return the full names of a task."""
    for name in TASKS[task].split():
        item = getattr(gb, name)
        if inspect.ismodule(item):
            here = (n for n in public(item) if getattr(item, n) is not getattr(gb, n, None))
            yield from (f"greybox.{name}.{n}" for n in here)
        else:
            yield f"greybox.{name}"


def write_reference(folder):
    """Write a page for each public name, and one that lists them by task."""
    text = ["API", "===", "", "`import greybox as gb` comes first in all examples.", ""]
    listed = " ".join(TASKS.values()).split()
    TASKS["More"] = " ".join(name for name in public(gb) if name not in listed)
    for task in filter(TASKS.get, TASKS):
        names = list(names_of(task))
        text += [task, "-" * len(task), ""]
        tree = ["", ".. toctree::", "   :hidden:", ""]
        for name in names:
            module, _, last = name.rpartition(".")
            found = getattr(import_module(module), last)
            title = name.replace("greybox", "gb", 1)
            kind = "class" if inspect.isclass(found) else "function"
            page = [title, "=" * len(title), "", f".. auto{kind}:: {name}"]
            page += ["   :members:"] if kind == "class" else []
            # Fit and fit would be one file on Windows and macOS.
            file = f"{name.removeprefix('greybox.')}-{kind}"
            (folder / f"{file}.rst").write_text("\n".join([*page, ""]), encoding="utf-8")
            tree.append(f"   {file}")
            summary = inspect.getdoc(found).split("\n\n")[0].split("\n")
            as_restructured_text(None, "", name, found, None, summary)
            text += [f":py:obj:`{title} <{name}>`", f"   {' '.join(summary)}"]
        text += [*tree, ""]
    (folder / "index.rst").write_text("\n".join(text), encoding="utf-8")


def mathml(node, display="inline"):
    """Return a formula as MathML, in which the bars of a magnitude take no space."""
    text = convert(node.astext(), display=display)
    return text.replace('<mo stretchy="false">&#x0007C;', '<mo lspace="0" rspace="0">&#x0007C;')


def inline_formula(translator, node):
    """Write a formula as MathML."""
    translator.body.append(mathml(node))
    raise SkipNode


def formula(translator, node):
    """Write a formula on a line of its own as MathML, which a phone may scroll."""
    style = "overflow-x: auto; margin: 1em 0"
    translator.body.append(f'<div style="{style}">{mathml(node, "block")}</div>')
    raise SkipNode


THUMBNAIL = "width: 100%; height: 7rem; object-fit: contain; background: white"
SECTION = re.compile(r"^## (.+?)\n.*?```python\n(.*?)```\n", re.DOTALL | re.MULTILINE)
GALLERY = """<div style="display: grid; grid-template-columns: repeat(auto-fill, minmax(9rem, 1fr));
gap: 1rem; align-items: end">"""


def draw_gallery(_app, page, source):
    """Run the examples of the gallery, and show each figure above its lines."""
    if page != "gallery":
        return
    folder = HERE / "figures"
    folder.mkdir(exist_ok=True)
    names, thumbnails = {}, [GALLERY]

    def drawn(match):
        title, lines = match.groups()
        with tempfile.TemporaryDirectory() as empty, contextlib.chdir(empty):
            exec(lines, names)
        name = re.sub(r"\W+", "-", title.lower()).strip("-")
        names["figure"].savefig(folder / f"{name}.png", dpi=110)
        picture = f'<img src="_images/{name}.png" alt="" style="{THUMBNAIL}">'
        thumbnails.append(f'<a href="#{name}">{picture}<br>{title}</a>')
        shown = f"({name})=\n## {title}\n\n```{{image}} figures/{name}.png\n:alt: {title}\n"
        shown += f":target: _images/{name}.png\n```\n"
        return f"{shown}\n```python\n{lines}```\n"

    text = SECTION.sub(drawn, source[0])
    source[0] = text.replace("<!-- thumbnails -->", "\n".join([*thumbnails, "</div>"]))


OF_ALL = ("--help", "--json", "--quiet", "--debug")  # options of every command


def commands_page():
    """Return the page of the commands, from their parser."""
    parser = parser_of()
    (parsers,) = (action.choices for action in parser._actions if action.choices)
    text = [
        "# Commands",
        "",
        "`greybox COMMAND --help` prints the same. Every command also takes these options:",
        "",
        *options(parsers["list"], lambda action: action.option_strings[-1:] and is_of_all(action)),
    ]
    for group, names in GROUPS.items():
        text += [f"## {group.capitalize()}", ""]
        for name in names:
            command = parsers[name]
            examples = command.epilog.partition("\n")[2].replace("  greybox", "$ greybox")
            text += [f"### `greybox {name}`", "", command.description, ""]
            text += ["```console", examples, "```", ""]
            text += options(command, lambda action: not is_of_all(action))
    return "\n".join(text)


def is_of_all(action):
    return action.option_strings[-1:] and action.option_strings[-1] in OF_ALL


def options(command, chosen):
    """Yield the options of a command as a list of definitions."""
    formatter = command._get_formatter()
    for action in filter(chosen, command._actions):
        form = formatter._format_action_invocation(action)
        form = re.sub(r"(\S+) \[\1 \.\.\.\]", r"\1...", form)
        about = re.sub(r"([\\*_\[<$|])", r"\\\1", action.help)
        about = re.sub(r"(?<!\S)(--[\w-]+|'[^']+')", lambda m: f"`{m[1].strip(chr(39))}`", about)
        yield from (f"`{form}`", f": {about}", "")


def write_sources(_):
    """Copy the notebooks and write the pages of the commands and of the reference."""
    (HERE / "commands.md").write_text(commands_page(), encoding="utf-8")
    shutil.rmtree(HERE / "notebooks", ignore_errors=True)
    shutil.copytree(
        HERE.parent / "notebooks", HERE / "notebooks", ignore=shutil.ignore_patterns(".*")
    )
    stories = "# Stories\n\n```{toctree}\n:maxdepth: 1\n:glob:\n\n*_*\n```\n"
    (HERE / "notebooks" / "index.md").write_text(stories, encoding="utf-8")
    api = HERE / "api"
    shutil.rmtree(api, ignore_errors=True)
    api.mkdir()
    write_reference(api)


LITERAL = re.compile(r"(``.+?``|:math:`.+?`|`.+?`)")


def as_restructured_text(_app, _what, _name, _object, _options, lines):
    """Let `$...$` in docstrings be a formula, and a magnitude `|r|` no substitution."""
    text = re.sub(r"\$([^$]+)\$", r":math:`\1`", "\n".join(lines))
    pieces = LITERAL.split(text)
    pieces[::2] = [piece.replace("|", r"\|") for piece in pieces[::2]]
    lines[:] = "".join(pieces).split("\n")


ATTRIBUTE = re.compile(r"(\w+(?:, \w+)*)(?: : (.*))?")


def attributes_as_members(_app, _what, _name, _object, _options, lines):
    """Write what stands below "Attributes" as members: `a, b : float` as one entry for each."""
    if "Attributes" not in lines:
        return
    begin = k = lines.index("Attributes")
    made, k = [], begin + 2
    while k < len(lines) and not "".join(lines[k + 1 : k + 2]).startswith("---"):
        end = k + 1
        while end < len(lines) and lines[end].startswith(" "):
            end += 1
        found = ATTRIBUTE.fullmatch(lines[k])
        for name in found[1].split(", ") if found else ():
            made += ["", f".. attribute:: {name}", f"    :type: {found[2] or ''}", ""]
            made += lines[k + 1 : end]
        k = end
    lines[begin:k] = [*made, ""]


def results_are_not_constructed(_app, what, _name, item, _options, signature, _returns):
    """Leave out the constructor of a class whose docstring has attributes alone: a result."""
    text = inspect.getdoc(item) or ""
    if what == "class" and "\nAttributes\n" in text and "\nParameters\n" not in text:
        return "", None
    return signature, None


def setup(app):
    """Connect what is above."""
    app.connect("builder-inited", write_sources, priority=100)
    # Before napoleon.
    app.connect("autodoc-process-docstring", attributes_as_members, priority=100)
    app.connect("autodoc-process-signature", results_are_not_constructed)
    app.connect("source-read", draw_gallery)
    app.add_html_math_renderer("mathml", (inline_formula, None), (formula, None))
    app.connect("autodoc-process-docstring", as_restructured_text)
