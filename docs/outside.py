"""Pages link to files beside the documentation (`../weights/...`); on the site those are pages too.

A hook of MkDocs.  Each file that a page links to, or an image that it shows, becomes a page below
`repository/`: Markdown as it is, notebooks with the outputs that they keep, all else as a listing.
"""

import base64
import json
import os
import re
from pathlib import Path

from mkdocs.config.defaults import MkDocsConfig
from mkdocs.structure.files import File, Files

ROOT = Path(__file__).resolve().parents[1]
DOCS, SITE = "docs", "repository"
LINK = re.compile(r"(\]\()(?!\w+:|#)([^)\s#]+)(#[^)\s]*)?(?=\))")
LANGUAGES = {".py": "python", ".yaml": "yaml", ".json": "json", ".toml": "toml"}
PICTURES = (".png", ".svg")


def on_files(files: Files, config: MkDocsConfig) -> Files:
    """Add the pages of what lies outside."""
    for page in [file for file in files.documentation_pages() if file.abs_src_path]:
        _follow(f"{DOCS}/{page.src_uri}", page.content_string, files, config)
    return files


def on_page_markdown(markdown: str, page, config: MkDocsConfig, files: Files) -> str:
    """Links to what lies outside, as links to its page."""
    return _linked(markdown, *_homes(page.file.src_uri))


def _homes(uri: str) -> tuple[str, str]:
    """Where a page is in the repository, and where on the site."""
    inner = uri.removeprefix(f"{SITE}/").removesuffix(".md")
    return (inner if uri.startswith(f"{SITE}/") else f"{DOCS}/{uri}"), uri


def _target(link: str, source: str) -> str | None:
    """The file that a link of a file means, seen from the repository; None: none that is there."""
    path = os.path.normpath(os.path.join(os.path.dirname(source), link))
    return path if not path.startswith("..") and (ROOT / path).is_file() else None


def _uri(target: str) -> str:
    """Where a file of the repository is on the site."""
    if target.startswith(f"{DOCS}/"):
        return target.removeprefix(f"{DOCS}/")
    return f"{SITE}/{target}" if target.endswith(PICTURES) else f"{SITE}/{target}.md"


def _linked(markdown: str, source: str, uri: str) -> str:
    def mended(found: re.Match[str]) -> str:
        target = _target(found[2], source)
        if target is None:
            return found[0]  # MkDocs says that it leads nowhere
        there = os.path.relpath(_uri(target), os.path.dirname(uri) or ".")
        return f"{found[1]}{there}{found[3] or ''}"

    return LINK.sub(mended, markdown)


def _follow(source: str, markdown: str, files: Files, config: MkDocsConfig) -> None:
    """Add a page for everything outside that a text links to, and for what that links to."""
    for found in LINK.finditer(markdown):
        target = _target(found[2], source)
        if target is None or target.startswith(f"{DOCS}/"):
            continue
        uri = _uri(target)
        if files.get_file_from_path(uri) is not None:
            continue
        if target.endswith(PICTURES):
            content: str | bytes = (ROOT / target).read_bytes()
        else:
            text = (ROOT / target).read_text(encoding="utf-8")
            content = _page(target, text, files, config)
        files.append(File.generated(config, uri, content=content))
        if isinstance(content, str) and target.endswith((".md", ".ipynb")):
            _follow(target, content, files, config)


def _page(target: str, text: str, files: Files, config: MkDocsConfig) -> str:
    if target.endswith(".md"):
        return text
    if target.endswith(".ipynb"):
        return _lesson(target, json.loads(text), files, config)
    fence = "`" * 4
    return f"# {target}\n\n{fence}{LANGUAGES.get(Path(target).suffix, '')}\n{text}\n{fence}\n"


def _lesson(target: str, notebook: dict, files: Files, config: MkDocsConfig) -> str:
    """A notebook as Markdown; its pictures become files beside the page."""
    parts = []
    for cell in notebook["cells"]:
        source = "".join(cell["source"])
        if cell["cell_type"] == "markdown":
            # Formulas as they are written: what would draw them comes from elsewhere.
            shown = re.sub(r"\$\$(.+?)\$\$", r"```tex\n\1\n```", source, flags=re.DOTALL)
            parts.append(re.sub(r"\$([^$\n]+)\$", r"`\1`", shown))
            continue
        parts.append(f"```python\n{source}\n```")
        for output in cell.get("outputs", []):
            data = output.get("data", {})
            if "image/png" in data:
                name = f"{target}.{len(parts)}.png"
                picture = base64.b64decode(data["image/png"])
                files.append(File.generated(config, f"{SITE}/{name}", content=picture))
                parts.append(f"![output]({Path(name).name})")
            else:
                said = "".join(output.get("text", data.get("text/plain", "")))
                parts.append(f"```text\n{said.rstrip()}\n```")
    return "\n\n".join(parts)
