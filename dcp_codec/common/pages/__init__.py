"""HTML pages with one look: each is a self-contained file that loads nothing from the network.

The template of a page extends ``page.html``, and uses the macros of ``parts.html``. Needs Jinja.
"""

from __future__ import annotations

import base64
import hashlib
from importlib import resources
from typing import Any

from jinja2 import ChoiceLoader, Environment, PackageLoader, StrictUndefined
from markupsafe import Markup

from dcp_codec.common.printable import plain

from .colours import SCHEMES


def render(package: str, template: str, *scripts: str, **values: Any) -> str:
    """Return the page of a template of ``package``; ``scripts`` run in it after the script of all pages.

    Values are escaped, and control characters in them made visible: a browser would hide them, or reorder the line.
    The content security policy permits the scripts only, by their hash.
    """
    environment = Environment(
        loader=ChoiceLoader([PackageLoader(package), PackageLoader(__name__)]),
        autoescape=True,
        undefined=StrictUndefined,
        trim_blocks=True,
        lstrip_blocks=True,
        finalize=lambda value: plain(value, keep="\n\t") if type(value) is str else value,
    )
    # "</" would end the script element.
    script = "\n".join([text(__name__, "page.js"), *scripts]).replace("</", "<\\/")
    digest = base64.b64encode(hashlib.sha256(script.encode()).digest()).decode()
    policy = (
        f"default-src 'none'; script-src 'sha256-{digest}'; style-src 'unsafe-inline'; img-src data: blob:; "
        "base-uri 'none'; form-action 'none'"
    )
    # The scripts are files of packages, so they need no escaping.
    own = {"schemes": SCHEMES, "policy": Markup(policy), "script": Markup(script)}  # noqa: S704
    return environment.get_template(template).render(**own, **values)


def text(package: str, name: str) -> str:
    """Return a file in the folder ``templates`` of a package."""
    return resources.files(package).joinpath("templates", name).read_text(encoding="utf-8")
