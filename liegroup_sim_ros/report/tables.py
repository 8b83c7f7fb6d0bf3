# SPDX-License-Identifier: Apache-2.0
"""Tables whose columns are functions of entries, for a terminal and for a page; the entries themselves are JSON."""

from typing import NamedTuple


class TextTable(NamedTuple):
    """Table of texts; `terminal.printed` and `page.table` show it."""

    title: str | None
    heads: tuple
    rows: list  # of texts; on a terminal also rich Texts
    folded: int = 0  # number of columns whose texts may take several lines on a terminal
    right: tuple = ()  # numbers of the columns that are aligned to the right there


def table_of(columns, entries, title=None, folded=None):
    """Table of entries; columns : {head: function entry -> text}; folded : None: all."""
    rows = [[of(entry) for of in columns.values()] for entry in entries]
    return TextTable(title, tuple(columns), rows, len(columns) if folded is None else folded)
