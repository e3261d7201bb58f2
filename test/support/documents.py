"""The documents of the project, taken apart: blocks of code, links, headings."""
from dataclasses import dataclass
from pathlib import Path
import re

TOP = Path(__file__).resolve().parents[2]
PAGES = sorted(path.relative_to(TOP).as_posix() for path in (
    TOP / 'README.md', *TOP.glob('CONTRIBUTING.md'), *(TOP / 'doc').glob('*.md')))

_FENCE = re.compile(r'^```([^\n]*)\n(.*?)^```$', re.DOTALL | re.MULTILINE)


@dataclass(frozen=True)
class Block:
    """A fenced block of code: its page, its language and its text."""

    page: str
    language: str
    text: str


def blocks(*languages: str) -> list[Block]:
    """Return the blocks of all pages, those of some languages if any are named."""
    return [Block(page, language.strip(), text) for page in PAGES
            for language, text in _FENCE.findall((TOP / page).read_text())
            if not languages or language.strip() in languages]


def commands() -> list[str]:
    """Return the shell commands of all pages, one a line, without comments."""
    texts = [block.text.replace('\\\n', ' ') for block in blocks('sh')]
    texts += ['\n'.join(re.findall(r'^\$ (.*)', block.text, re.MULTILINE))
              for block in blocks('console')]
    lines = [line.split(' #')[0].strip() for text in texts for line in text.splitlines()]
    return [line for line in lines if line and not line.startswith('#')]


def links(page: str) -> list[str]:
    """Return the targets of the links and pictures of a page that are not on the web."""
    text = _FENCE.sub('', (TOP / page).read_text())
    targets = re.findall(r'\]\(([^)\s]+)\)', text)
    return [target for target in targets if not re.match(r'https?://|mailto:', target)]


def anchors(page: str) -> set[str]:
    """Return the anchors of a page's headings, as GitHub makes them."""
    headings = re.findall(r'^#+ (.*)$', _FENCE.sub('', (TOP / page).read_text()), re.MULTILINE)
    return {re.sub(r'[^\w\- ]', '', heading.strip().lower()).replace(' ', '-')
            for heading in headings}
