# SPDX-License-Identifier: Apache-2.0
"""Formulas of laws for the reference integration: Python's syntax tree in postfix order, for a stack machine.

The scene has been checked, so no formula is wrong here. It shares nothing with forces/formulas.py. An instruction is
(operation, argument): LOAD and STORE have the number of a value, PUSH that of a number, TABLE that of a table, KNOTS
before it that of its first surface: those of a table are its argument = x of a knot; < <= >
>= min max abs have 1 plus that of their surface a = b, negative with b and a exchanged. The others replace their
operands on top of the stack by their result; a condition is 1 or 0, or a share between them where the motion slides
along a surface.

A value is computed when it is first read, and of `x if c else y`, `c and x`, `c or x` only what c selects, so that a
contact in the air costs its depth: CALL reads a value that a formula gives, BRANCH UNLESS BOTH EITHER have the place of
the instruction where evaluation goes on after what is not needed.
"""

import ast
import math

import numpy as np

from liegroup_core.compiling import kernel, subroutine

LOAD, STORE, PUSH, TABLE, CHOOSE, KNOTS, CALL, BRANCH, UNLESS, BOTH = range(10)
EITHER = 29
_UNARY = {ast.USub: 10, ast.Not: 11, "sin": 12, "cos": 13, "tan": 14, "asin": 15, "acos": 16, "atan": 17}
_UNARY |= {"exp": 18, "log": 19, "sqrt": 20, "tanh": 21, "abs": 22}
_BINARY = {ast.Add: 30, ast.Sub: 31, ast.Mult: 32, ast.Div: 33, ast.Pow: 34, "atan2": 35, "min": 36, "max": 37}
_BINARY |= {ast.Lt: 38, ast.LtE: 39, ast.Gt: 40, ast.GtE: 41, ast.Eq: 42, ast.NotEq: 43, ast.And: 44, ast.Or: 45}
_NUMBERS = {"pi": math.pi, "inf": math.inf}


class Postfix:
    """Instructions of formulas, one after another.

    code : [(operation, argument)];  numbers : [float];  tables : [(k, 2) x, y];  deepest : largest size of the stack
    surfaces : {operands a, b, or place in the code: number};  begins : {number of a value: place of its formula}
    """

    def __init__(self):
        self.code, self.numbers, self.tables, self.deepest, self._size = [], [], [], 0, 0
        self.surfaces, self.begins, self._conditions, self._needs = {}, {}, set(), {}

    def add(self, text, names, tables, to):
        """Append a formula whose result is value number `to`.

        names : {name: number of a value, or a float};  tables : {name: number of a table}
        """
        self._names, self._tables = _NUMBERS | names, tables
        node, self._most = ast.parse(text, mode="eval").body, 0
        begin = len(self.code)
        self._walk(node)
        if self._is_condition(node):
            self._conditions.add(to)
        self._do(STORE, to, 1, 0)
        self.begins[to], self._needs[to] = begin, self._most
        self.deepest = max(self.deepest, self._most)

    def _is_condition(self, node):
        if isinstance(node, ast.Name):
            return self._names[node.id] in self._conditions
        is_not = isinstance(node, ast.UnaryOp) and isinstance(node.op, ast.Not)
        return is_not or isinstance(node, (ast.Compare, ast.BoolOp))

    def _condition(self, node):
        """As `_walk`, of a number whether it is not zero."""
        self._walk(node)
        if not self._is_condition(node):
            self._push(0.0)
            self._do(_BINARY[ast.NotEq], 0, 2)

    def _surface(self, op, *operands):
        """Argument of a comparison."""
        if isinstance(op, (ast.Eq, ast.NotEq)):
            return 0
        keys = []
        for node in operands:
            names = {each.id for each in ast.walk(node) if isinstance(each, ast.Name)}
            known = [(name, self._names.get(name, self._tables.get(name))) for name in sorted(names)]
            keys.append(f"{ast.unparse(node)} {known}")
        number = 1 + self.surfaces.setdefault(tuple(sorted(keys)), len(self.surfaces))
        return number if keys == sorted(keys) else -number

    def _knots(self, name):
        """x of the knots of a table."""
        return self.tables[self._tables[name]][:, 0].tolist()

    def _kink(self, operation, takes):
        """Append min, max or abs."""
        self.surfaces[len(self.code)] = number = len(self.surfaces)
        self._do(operation, 1 + number, takes)

    def _do(self, operation, argument, takes, gives=1):
        self.code.append((operation, argument))
        needs = self._needs[argument] if operation == CALL else 0
        self._size += gives - takes
        self._most = max(self._most, self._size + needs)

    def _skip(self, operation):
        """Append an instruction whose place `_land` sets; returns its own place."""
        self._do(operation, 0, 0, 0)
        return len(self.code) - 1

    def _land(self, place):
        """Let the instruction at a place go on with the next one."""
        self.code[place] = self.code[place][0], len(self.code)

    def _push(self, number):
        self.numbers.append(float(number))
        self._do(PUSH, len(self.numbers) - 1, 0)

    def _walk(self, node):
        if isinstance(node, ast.Constant):
            self._push(node.value)
        elif isinstance(node, ast.Name):
            known = self._names[node.id]
            if isinstance(known, float):
                self._push(known)
            else:
                self._do(CALL if known in self.begins else LOAD, known, 0)
        elif isinstance(node, ast.UnaryOp):
            (self._condition if isinstance(node.op, ast.Not) else self._walk)(node.operand)
            if not isinstance(node.op, ast.UAdd):
                self._do(_UNARY[type(node.op)], 0, 1)
        elif isinstance(node, ast.BinOp):
            self._apply(_BINARY[type(node.op)], node.left, node.right)
        elif isinstance(node, ast.BoolOp):
            self._condition(node.values[0])
            for other in node.values[1:]:
                place = self._skip(BOTH if isinstance(node.op, ast.And) else EITHER)
                self._condition(other)
                self._do(_BINARY[type(node.op)], 0, 2)
                self._land(place)
        elif isinstance(node, ast.Compare):
            values = node.left, *node.comparators
            for k, op in enumerate(node.ops):
                self._walk(values[k])
                self._walk(values[k + 1])
                self._do(_BINARY[type(op)], self._surface(op, values[k], values[k + 1]), 2)
                if k > 0:
                    self._do(_BINARY[ast.And], 0, 2)
        elif isinstance(node, ast.IfExp):
            self._condition(node.test)
            branch = self._skip(BRANCH)
            self._walk(node.body)
            unless = self._skip(UNLESS)
            self._land(branch)
            self._walk(node.orelse)
            self._do(CHOOSE, 0, 3)
            self._land(unless)
        else:
            self._call(node.func.id, node.args)

    def _apply(self, operation, first, *others):
        """Apply an operation of two operands from left to right."""
        self._walk(first)
        for other in others:
            self._walk(other)
            self._do(operation, 0, 2)

    def _call(self, name, arguments):
        if name == "clip":
            value, low, high = arguments
            self._call("max", [value, low])
            self._walk(high)
            self._kink(_BINARY["min"], 2)
        elif name in ("min", "max"):
            self._walk(arguments[0])
            for other in arguments[1:]:
                self._walk(other)
                self._kink(_BINARY[name], 2)
        elif name in _BINARY:
            self._apply(_BINARY[name], *arguments)
        elif name == "abs":
            self._walk(arguments[0])
            self._kink(_UNARY[name], 1)
        else:
            self._walk(arguments[0])
            known = name in _UNARY
            if not known:
                self._do(KNOTS, len(self.surfaces), 1)
                self.surfaces |= {(len(self.code), x): len(self.surfaces) + j for j, x in enumerate(self._knots(name))}
            self._do(_UNARY[name] if known else TABLE, 0 if known else self._tables[name], 1)


@kernel
def _interpolated(first, points, number, x):
    """Value of a table; its points are those from first[number] on."""
    begin, end = first[number], first[number + 1]
    k = begin
    while k < end and points[k, 0] <= x:
        k += 1
    if k == begin or k == end:
        return points[min(k, end - 1), 1] + 0.0 * x
    share = (x - points[k - 1, 0]) / (points[k, 0] - points[k - 1, 0])
    return (1.0 - share) * points[k - 1, 1] + share * points[k, 1]


@kernel
def _unary(operation, a):
    if operation < 15:
        if operation < 12:
            return -a if operation == 10 else 1.0 - a
        return np.sin(a) if operation == 12 else (np.cos(a) if operation == 13 else np.tan(a))
    if operation < 18:
        return np.arcsin(a) if operation == 15 else (np.arccos(a) if operation == 16 else np.arctan(a))
    if operation < 20:
        return np.exp(a) if operation == 18 else np.log(a)
    return np.sqrt(a) if operation == 20 else (np.tanh(a) if operation == 21 else np.abs(a))


@kernel
def _comparison(operation, a, b):
    if operation < 42:
        below = a < b if operation == 38 else a <= b
        above = a > b if operation == 40 else a >= b
        return below if operation < 40 else above
    return a == b if operation == 42 else a != b


@kernel
def _binary(operation, a, b):
    if operation < 33:
        return a + b if operation == 30 else (a - b if operation == 31 else a * b)
    if operation < 36:
        return a / b if operation == 33 else (a**b if operation == 34 else np.arctan2(a, b))
    if operation < 38:
        return np.minimum(a, b) if operation == 36 else np.maximum(a, b)
    if operation < 44:
        return 1.0 * _comparison(operation, a, b)
    return a * b if operation == 44 else a + b - a * b


@subroutine
def evaluate(code, begins, needed, numbers, first, points, stack, values, sides, heights):
    """Compute needed values of (m,) by instructions (p, 2); the points of table k are points[first[k]:first[k + 1]].

    begins  : (m,) place of the formula of a value, or -1: it is given
    sides   : (c,) shares of a < b of all surfaces; infinite: a and b decide
    heights : (c,) a - b, written; NaN where nothing needs it
    """
    top, known, back = -1, np.zeros(len(values)), np.zeros(len(values), dtype=np.int64)
    heights[:] = np.nan
    for number in needed:
        i, depth = begins[number], 0
        while known[number] == 0.0:
            operation, argument = code[i, 0], code[i, 1]
            i += 1
            if operation >= 30:
                top -= 1
                a, b, k = stack[top], stack[top + 1], abs(argument) - 1
                stack[top] = _binary(operation, a, b)
                if k >= 0:
                    heights[k] = a - b if argument > 0 else b - a
                    if sides[k] < np.inf:
                        share = sides[k] if argument > 0 else 1.0 - sides[k]  # of a < b here
                        if operation > 37:
                            stack[top] = share if operation < 40 else 1.0 - share
                        elif share == 0.0 or share == 1.0:
                            stack[top] = a if (share == 1.0) == (operation == 36) else b
            elif operation == CALL and known[argument] == 0.0:
                back[depth], i = i - 1, begins[argument]
                depth += 1
            elif operation == LOAD or operation == PUSH or operation == CALL:
                top += 1
                stack[top] = numbers[argument] if operation == PUSH else values[argument]
            elif operation == STORE:
                values[argument], known[argument] = stack[top], 1.0
                top -= 1
                if depth > 0:
                    depth -= 1
                    i = back[depth]
            elif operation == BRANCH:
                if stack[top] == 0.0:
                    top += 1
                    stack[top], i = 0.0, argument
            elif operation == UNLESS:
                if stack[top - 1] == 1.0:
                    top -= 1
                    stack[top], i = stack[top + 1], argument
            elif operation == BOTH or operation == EITHER:
                if stack[top] == (0.0 if operation == BOTH else 1.0):
                    i = argument
            elif operation == TABLE:
                stack[top] = _interpolated(first, points, argument, stack[top])
            elif operation == KNOTS:
                table = code[i, 1]
                for j in range(first[table + 1] - first[table]):
                    heights[argument + j] = stack[top] - points[first[table] + j, 0]
            elif operation == CHOOSE:
                top -= 2
                share = stack[top]
                stack[top] = stack[top + 2] if share == 0.0 else share * stack[top + 1] + (1.0 - share) * stack[top + 2]
            else:
                a = stack[top]
                stack[top] = _unary(operation, a)
                if operation == 22:
                    heights[argument - 1] = a
                    if sides[argument - 1] < np.inf:
                        stack[top] = (1.0 - 2.0 * sides[argument - 1]) * a
