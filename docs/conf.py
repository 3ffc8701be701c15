"""The documentation site: `sphinx-build -W docs site`.

Pages are the Markdown files here. The notebooks are executed, the page of the commands is made from
their parser, and the API reference from the docstrings of the public names; none of these is kept.
"""

import inspect
import re
import shutil
from importlib import import_module
from pathlib import Path

import greybox as gb
from greybox.cli.main import GROUPS, parser_of

HERE = Path(__file__).parent
FOLDERS = """
data logs spectral modeling formulation regression solve simulation validation experiment interop
identification study plotting
"""

project = "greybox"
copyright = "the greybox authors"
version = release = gb.__version__
extensions = [
    "myst_nb",
    "sphinx.ext.autodoc",
    "sphinx.ext.mathjax",
    "sphinx.ext.napoleon",
    "sphinx.ext.viewcode",
    "sphinx_copybutton",
]
exclude_patterns = ["jupyter_execute"]
myst_enable_extensions = ["deflist", "dollarmath"]
myst_heading_anchors = 3
nb_execution_timeout = 600
nb_execution_raise_on_error = True
nb_execution_show_tb = True
nb_merge_streams = True
autodoc_member_order = "bysource"
autodoc_typehints = "none"  # the docstrings give shapes and units, which types do not
napoleon_use_rtype = False
napoleon_use_ivar = True
toc_object_entries = False
default_role = "code"
suppress_warnings = ["ref.python"]  # an attribute that several classes have is no link
html_theme = "pydata_sphinx_theme"
html_title = "greybox"
html_theme_options = {"show_toc_level": 2, "navbar_align": "left", "show_prev_next": False}
html_show_sourcelink = False


def public(module):
    """Return the public classes and functions of a module, in order of the alphabet."""
    names = (name for name in dir(module) if not name.startswith("_"))
    return [
        n
        for n in names
        if inspect.isclass(getattr(module, n)) or inspect.isroutine(getattr(module, n))
    ]


def page(title, module, names):
    """Return a page of the reference."""
    text = [title, "=" * len(title), "", f".. currentmodule:: {module}", ""]
    for name in names:
        found = getattr(import_module(module), name)
        kind = "autoclass" if inspect.isclass(found) else "autofunction"
        text += [name, "-" * len(name), "", f".. {kind}:: {name}"]
        text += ["   :members:", ""] if kind == "autoclass" else [""]
    return "\n".join(text)


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
    stories = "# Stories\n\n```{toctree}\n:maxdepth: 1\n:glob:\n\n0*\n```\n"
    (HERE / "notebooks" / "index.md").write_text(stories, encoding="utf-8")
    api = HERE / "api"
    shutil.rmtree(api, ignore_errors=True)
    api.mkdir()
    top = public(gb)
    (api / "greybox.rst").write_text(page("greybox", "greybox", top), encoding="utf-8")
    for folder in FOLDERS.split():
        module = f"greybox.{folder}"
        only_here = [name for name in public(import_module(module)) if name not in top]
        (api / f"{folder}.rst").write_text(
            page(f"greybox.{folder}", module, only_here), encoding="utf-8"
        )
    contents = "\n".join(f"   {name}" for name in ("greybox", *FOLDERS.split()))
    (api / "index.rst").write_text(
        f"API\n===\n\n.. toctree::\n   :maxdepth: 2\n\n{contents}\n", encoding="utf-8"
    )


LITERAL = re.compile(r"(``.+?``|:math:`.+?`|`.+?`)")


def as_restructured_text(_app, _what, _name, _object, _options, lines):
    """Let `$...$` in docstrings be a formula, and a magnitude `|r|` no substitution."""
    text = re.sub(r"\$([^$]+)\$", r":math:`\1`", "\n".join(lines))
    pieces = LITERAL.split(text)
    pieces[::2] = [piece.replace("|", r"\|") for piece in pieces[::2]]
    lines[:] = "".join(pieces).split("\n")


SEVERAL = re.compile(r"(\s*)(\w+(?:, \w+)+) : (.*)")


def one_attribute_each(_app, _what, _name, _object, _options, lines):
    """Give `a, b : float` below "Attributes" an entry for each, which napoleon does not."""
    if "Attributes" not in lines:
        return
    begin = lines.index("Attributes") + 2
    made, k = lines[:begin], begin
    while k < len(lines):
        end = k + 1
        while end < len(lines) and lines[end].startswith(" "):
            end += 1
        found = SEVERAL.fullmatch(lines[k])
        for name in found[2].split(", ") if found else [""]:
            made += [f"{found[1]}{name} : {found[3]}" if found else lines[k], *lines[k + 1 : end]]
        k = end
    lines[:] = made


def setup(app):
    """Connect what is above."""
    app.connect("builder-inited", write_sources, priority=100)
    app.connect("autodoc-process-docstring", one_attribute_each, priority=100)  # before napoleon
    app.connect("autodoc-process-docstring", as_restructured_text)
