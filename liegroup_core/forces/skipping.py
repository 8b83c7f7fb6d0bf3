# SPDX-License-Identifier: Apache-2.0
"""Order of the instructions of formulas in which evaluation skips what a condition does not need.

What only `x` of `x if c else 0`, or only `b` of `a and b`, needs is a block that is evaluated where the condition is
true. Elsewhere the results that others read are zero, with their derivatives, and the rest keeps old numbers that
nobody reads. Blocks are nested. So a point of a contact in the air costs its depth. Values do not depend on the order.

A block in `arrange`'s code is

    (SKIP, m, c, n, f)   where the register c is zero, what follows is skipped; its own register f is 1 where it is not
    m rows               five registers each, which are then set to zero
    n instructions
"""

import heapq
from collections import defaultdict

from .formulas import AND, SELECT, SKIP

LEAST = 4  # instructions of a block: to skip costs about one
HEAD, CLEAR = -2, -1  # in place of the number of an instruction


def arrange(code, needed, zero, new):
    """[(instruction, number in `code` or HEAD or CLEAR, register f of its block or -1)] of what is needed, in order.

    code : [(operation, to, a, b, c)];  needed : registers that are read at any time;  zero : register of the number 0
    new  : function that gives a new register
    A path has the registers of the conditions of all blocks around an instruction, () at top level.
    returns this, and {register: path of those who read it}
    """
    made = {instruction[1]: i for i, instruction in enumerate(code)}
    bases, paths = _paths(code, needed, zero)
    sizes = defaultdict(int)
    for path in paths.values():
        for k in range(len(path)):
            sizes[path[: k + 1]] += 1
    for found in (bases, paths):
        for i, path in found.items():
            found[i] = tuple(c for k, c in enumerate(path) if sizes[path[: k + 1]] >= LEAST)
    return _ordered(code, made, bases, paths, new), bases


def instructions(rows):
    """Instructions of `arrange`'s rows, without what begins blocks."""
    i = 0
    while i < len(rows):
        if rows[i][0] == SKIP:
            i += 1 + rows[i][1]
        else:
            yield rows[i]
            i += 1


def _paths(code, needed, zero):
    """({register: path of those who read it}, {number: path on which an instruction is computed})."""
    chains, bases, paths = {}, dict.fromkeys(needed, ()), {}

    def is_guarded(i):
        return code[i][0] == AND or code[i][0] == SELECT and code[i][4] == zero

    for i, (_, to, a, *_) in enumerate(code):  # conditions without which a result is zero, and itself
        chains[to] = (*(chains.get(a, (a,)) if is_guarded(i) else ()), to)

    def read(register, path):
        before = bases.setdefault(register, path)
        if before == path:
            return
        same = next((k for k, pair in enumerate(zip(before, path)) if pair[0] != pair[1]), None)
        bases[register] = before[: min(len(before), len(path)) if same is None else same]

    for i in range(len(code) - 1, -1, -1):
        operation, to, a, b, c = code[i]
        if to not in bases:
            continue
        paths[i] = inner = base = bases[to]
        if operation in (AND, SELECT):
            inner = base + tuple(each for each in chains.get(a, (a,)) if each not in base)
        if is_guarded(i):
            paths[i] = inner
        for register, path in ((a, base), (b, inner), (c, base)):
            read(register, path)
    return bases, paths


class _Block:
    """Instructions on one path that may come next, and the inner blocks that have such ones."""

    __slots__ = "condition", "inner", "outer", "ready"

    def __init__(self, condition, outer):
        self.condition, self.outer, self.ready, self.inner = condition, outer, [], {}

    def add(self, i):
        heapq.heappush(self.ready, i)
        block = self
        while block.outer is not None and block.condition not in block.outer.inner:
            block.outer.inner[block.condition] = block
            block = block.outer


def _ordered(code, made, bases, paths, new):
    """Rows of `arrange`: each instruction comes after what it reads, and after the conditions of its blocks."""
    blocks, waits, readers = {(): _Block(-1, None)}, {}, defaultdict(list)
    for path in paths.values():
        for k in range(len(path)):
            if path[: k + 1] not in blocks:
                blocks[path[: k + 1]] = _Block(path[k], blocks[path[:k]])
    for i, path in sorted(paths.items()):
        inputs = {made[r] for r in (*code[i][2:], *path) if r in made} & paths.keys()
        waits[i] = len(inputs)
        for each in inputs:
            readers[each].append(i)
        if not inputs:
            blocks[path].add(i)

    def filled(block, depth, flag):
        rows = []
        while block.ready or block.inner:
            if block.ready:
                i = heapq.heappop(block.ready)
                rows.append((code[i], i, flag))
                for each in readers[i]:
                    waits[each] -= 1
                    if not waits[each]:
                        blocks[paths[each]].add(each)
                continue
            condition, inner = next(iter(block.inner.items()))
            own = new()
            inside = filled(inner, depth + 1, own)
            del block.inner[condition]
            zeros = {row[4] for row, i, _ in inside if i == HEAD}
            zeros |= {row[1] for row, i, _ in inside if i >= 0 and len(bases[row[1]]) <= depth}
            zeros = sorted(zeros)
            zeros += zeros[:1] * (-len(zeros) % 5)
            clears = [tuple(zeros[k : k + 5]) for k in range(0, len(zeros), 5)]
            head = [(SKIP, len(clears), condition, len(inside), own), *clears]
            rows += [(row, HEAD if k == 0 else CLEAR, flag) for k, row in enumerate(head)] + inside
        return rows

    return filled(blocks[()], 0, -1)
