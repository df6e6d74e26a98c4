"""The table of a family of limits as the docs have it."""

from vio_eval_ros.core.limits import Limits


def limits_table(kind: type[Limits]) -> str:
    """Return the Markdown table of every limit: name, default, unit, meaning and source."""
    lines = ['| limit | default | unit | meaning | source |', '|---|---:|---|---|---|']
    lines += [
        f'| `{one.name}` | {one.value:g} | {one.unit} | {one.meaning} | {one.source} |'
        for one in kind.described()
    ]
    return '\n'.join(lines)
