# SPDX-License-Identifier: Apache-2.0
"""Formulas in texts of a scene: checked trees, compiled to instructions that a kernel evaluates.

A formula has numbers, names, + - * / **, comparisons, and, or, not, `a if condition else b` and the functions of
FUNCTIONS. Nothing of a text is executed by Python: its syntax tree is walked, and what is not in this list is refused.

An instruction (operation, to, a, b, c) reads the registers a, b, c and writes the register `to`. Every result has a
register of its own, and equal expressions share one. A register is a pair (value, derivative along one direction):
`evaluate` computes the values, `differentiate` also the derivatives, by the forward mode of automatic differentiation.
All comparisons of the same two registers are one surface, with one branch.

A value that is not defined (the root of a negative number) is NaN, and one beyond the largest number is infinite:
the step that meets it fails. A condition is 1 or 0; at a kink the derivative is that of one side.

A comparison, min, max, abs or table has branches, and is smooth within one. Its operand c is a register with the
branch that holds: 0, that of the arguments; else the given one goes on beyond its end, so that a step of any method
sees a smooth function. `distances` are those to the ends of the branch, for events/crossings.py. Source: Griewank and
Walther, Evaluating Derivatives, chapter 3. Accuracy: test/core/test_laws.py, against 50 digits.
"""

import ast
import contextlib
import math
import warnings

import numpy as np

from liegroup_core.compiling import kernel
from liegroup_core.fields.values import LARGEST_NUMBER, QUOTE, suggestion

(
    ADD,
    SUBTRACT,
    MULTIPLY,
    DIVIDE,
    POWER,
    NEGATIVE,
    LESS,
    LESS_EQUAL,
    EQUAL,
    AND,
    OR,
    NOT,
    SELECT,
    MIN,
    MAX,
    ABS,
    SQRT,
    EXP,
    LOG,
    SIN,
    COS,
    TAN,
    ASIN,
    ACOS,
    ATAN,
    ATAN2,
    TANH,
    TABLE,
    MORE,
    MORE_EQUAL,
    SKIP,
) = range(31)

# {name: (operation, number of arguments)}; min, max and clip are lists of operations
FUNCTIONS = {
    "sin": (SIN, 1),
    "cos": (COS, 1),
    "tan": (TAN, 1),
    "asin": (ASIN, 1),
    "acos": (ACOS, 1),
    "atan": (ATAN, 1),
    "atan2": (ATAN2, 2),
    "exp": (EXP, 1),
    "log": (LOG, 1),
    "sqrt": (SQRT, 1),
    "tanh": (TANH, 1),
    "abs": (ABS, 1),
    "min": (MIN, 2),
    "max": (MAX, 2),
    "clip": (MIN, 3),
}
CONSTANTS = {"pi": math.pi, "inf": math.inf}
TIME = "t"  # name of the time, s: register 0
RESERVED = (TIME, *CONSTANTS, *FUNCTIONS)
ORDERS = {ast.Lt: LESS, ast.LtE: LESS_EQUAL, ast.Gt: MORE, ast.GtE: MORE_EQUAL}
BINARY = {ast.Add: ADD, ast.Sub: SUBTRACT, ast.Mult: MULTIPLY, ast.Div: DIVIDE, ast.Pow: POWER}
LONGEST = 2000  # characters of a formula
DEEPEST = 200  # levels of its tree
# Of all formulas of a scene: 8 s to load. 2000 points of contact have 4000 states.
MOST_INSTRUCTIONS = 200_000
MOST_FACTORS = 16  # of a power that is computed by products
_LARGEST_EXPONENT = 709.78  # exp of more exceeds the largest number
COMPARISONS = (LESS, LESS_EQUAL, MORE, MORE_EQUAL)
CONDITIONS = (*COMPARISONS, EQUAL, AND, OR, NOT)
BRANCHED = (*COMPARISONS, MIN, MAX, ABS, TABLE)
TURNED = {LESS: MORE, LESS_EQUAL: MORE_EQUAL, MORE: LESS, MORE_EQUAL: LESS_EQUAL}  # with the arguments exchanged
# Branches: of two arguments a > b and a < b, of abs a > 0 and a < 0; of a table see `branch_of_segment`.
UNKNOWN, LOOSE, OPEN, ABOVE, BELOW = 0.0, 0.25, 0.5, 1.0, -1.0  # the first three: that of the arguments at any time
SHARED = 4.0  # of a comparison: plus the share of BELOW in a sliding motion, see dynamics/sliding.py


class FormulaError(ValueError):
    """Formula that is refused; one line."""


class Program:
    """Instructions and registers of formulas.

    registers : [float] start values, of which numbers and parameters keep theirs
    code      : [(operation, to, a, b, c)]
    tables    : [(x, y)], points of each table
    """

    def __init__(self):
        self.registers, self.code, self.tables = [0.0], [], []
        self._numbers, self._known, self._surfaces, self._others = {}, {}, {}, 0
        self.conditions = set()  # registers that are 0 or 1, or a share
        self.constants = set()  # registers of numbers and parameters
        self.follows = False  # whether branches of what comes are always those of their arguments
        self.followed = set()  # numbers of instructions with such branches
        self.bent = set()  # and of those where nothing jumps

    @contextlib.contextmanager
    def apart(self):
        """Instructions of their own, executed at other times: they share no result with others. Yields their list."""
        kept = self.code, self._known, self._surfaces, self._others
        self.code, self._known, self._surfaces, self._others = [], {}, {}, self._others + len(self.code)
        try:
            yield self.code
        finally:
            count = len(self.code)
            self.code, self._known, self._surfaces, self._others = kept
            self._others += count

    def new(self, value=0.0):
        """Register of its own, such as that of an input."""
        self.registers.append(value)
        return len(self.registers) - 1

    def number(self, value):
        """Register of a number, which equal ones share."""
        key = math.copysign(1.0, value), value
        if key not in self._numbers:
            self._numbers[key] = self.constant(value)
        return self._numbers[key]

    def constant(self, value):
        """Register of its own of a parameter."""
        self.constants.add(self.new(value))
        return len(self.registers) - 1

    def table(self, x, y):
        """Number of a new table; it also takes a register, so that its number is that of one, too."""
        self.tables.append((x, y))
        self.new()
        return len(self.tables) - 1

    def do(self, operation, a, b=0, c=0):
        """Register of the result of an operation."""
        follows = self.follows and operation in BRANCHED
        key = operation, a, b, c, follows
        if key not in self._known:
            if self._others + len(self.code) >= MOST_INSTRUCTIONS:
                raise FormulaError(
                    f"the laws and contacts of a scene must have at most {MOST_INSTRUCTIONS} operations, of which a "
                    "point of contact takes some 100: omit some, such as all but the feet by links of ground"
                )
            self._known[key] = to = self.new()
            if operation in COMPARISONS:
                surface = a, b, follows
                c = self._surfaces.get(surface) or self._surfaces.setdefault(surface, self.new())
            elif operation in BRANCHED:
                c = self.new()
            if operation in CONDITIONS:
                self.conditions.add(to)
            if follows:
                self.followed.add(len(self.code))
            self.code.append((operation, to, a, b, c))
        return self._known[key]

    def compare(self, operation, a, b):
        """Register of a comparison, 0 or 1."""
        return self.do(operation, a, b) if a < b else self.do(TURNED[operation], b, a)

    def truth(self, a):
        """Register of a condition: a itself, or whether it is not zero."""
        return a if a in self.conditions else self.do(NOT, self.do(EQUAL, a, self.number(0.0)))

    def read_from(self, first):
        """{register} that instructions from a number on read."""
        return {each for operation, _, a, b, c in self.code[first:] for each in (a, c, a if operation == TABLE else b)}

    def branched(self, results):
        """{number of an instruction} with branches, on which a set of registers depends."""
        needed, found = {*results}, set()
        for i in range(len(self.code) - 1, -1, -1):
            operation, to, *given = self.code[i]
            if to in needed:
                needed.update(given)
                if operation in BRANCHED:
                    found.add(i)
        return found

    def compile(self, text, names, tables=()):
        """Register of the value of a formula.

        names : {name: register};  tables : {name: number of a table}
        Raises FormulaError.
        """
        return _Walk(self, names, dict(tables)).of(tree(text), 0)


def tree(text):
    """Syntax tree of a formula, a text or a number. Raises FormulaError for what is no expression."""
    if isinstance(text, str) and len(text) > LONGEST:
        raise FormulaError(f"a formula must have at most {LONGEST} characters, this one has {len(text)}")
    try:
        with warnings.catch_warnings():
            warnings.simplefilter("ignore")  # of Python's parser about odd but clear texts
            return ast.parse(text if isinstance(text, str) else repr(text), mode="eval").body
    except (SyntaxError, ValueError, MemoryError, RecursionError) as error:
        reason = error.msg if isinstance(error, SyntaxError) else "too deep or not a text"
        hint = f"; {QUOTE}" if "never closed" in reason else ""
        raise FormulaError(f"{text!r:.60} is no formula: {reason}{hint}") from None


class _Walk:
    """Compiles one tree."""

    def __init__(self, program, names, tables):
        self._program, self._names, self._tables = program, names, tables
        self._do = program.do

    def of(self, node, depth):
        """Register of the value of a node."""
        if depth > DEEPEST:
            raise FormulaError(f"a formula must have at most {DEEPEST} levels of operations: split it into signals")
        visit = getattr(self, f"_{type(node).__name__}", None)
        if visit is None:
            raise FormulaError(f"{ast.unparse(node)!r:.60} cannot be used in a formula")
        return visit(node, depth + 1)

    def _Constant(self, node, _):
        if type(node.value) not in (int, float):
            raise FormulaError(f"{node.value!r:.60} is not a number")
        if not abs(node.value) <= LARGEST_NUMBER:
            raise FormulaError(f"{node.value!r:.60} must be at most {LARGEST_NUMBER:g} in magnitude")
        return self._program.number(float(node.value))

    def _Name(self, node, _):
        if node.id in CONSTANTS:
            return self._program.number(CONSTANTS[node.id])
        if node.id in FUNCTIONS or node.id in self._tables:
            raise FormulaError(f"{node.id} is a function: write its argument in parentheses")
        if node.id not in self._names:
            raise FormulaError(f"unknown name {node.id!r:.60}; {suggestion(node.id, [*self._names, *RESERVED[1:]])}")
        return self._names[node.id]

    def _UnaryOp(self, node, depth):
        value = self.of(node.operand, depth)
        if isinstance(node.op, ast.UAdd):
            return value
        if isinstance(node.op, ast.USub):
            return self._do(NEGATIVE, value)
        if isinstance(node.op, ast.Not):
            return self._do(NOT, self._program.truth(value))
        raise FormulaError(f"{ast.unparse(node)!r:.60} cannot be used in a formula")

    def _BinOp(self, node, depth):
        if type(node.op) not in BINARY:
            raise FormulaError(f"{ast.unparse(node)!r:.60}: use + - * / ** only")
        a = self.of(node.left, depth)
        if isinstance(node.op, ast.Pow) and isinstance(node.right, ast.Constant):
            count = node.right.value
            if type(count) is int and 1 <= count <= MOST_FACTORS:
                return self._product(a, count)
        return self._do(BINARY[type(node.op)], a, self.of(node.right, depth))

    def _product(self, a, count):
        """Power with a small whole exponent, by squares."""
        if count == 1:
            return a
        half = self._product(a, count // 2)
        square = self._do(MULTIPLY, half, half)
        return self._do(MULTIPLY, square, a) if count % 2 else square

    def _Compare(self, node, depth):
        values = [self.of(each, depth) for each in (node.left, *node.comparators)]
        found = [self._comparison(op, a, b) for op, a, b in zip(node.ops, values, values[1:])]
        return self._all(AND, found)

    def _comparison(self, op, a, b):
        if type(op) in ORDERS:
            return self._program.compare(ORDERS[type(op)], a, b)
        if isinstance(op, ast.Eq):
            return self._do(EQUAL, a, b)
        if isinstance(op, ast.NotEq):
            return self._do(NOT, self._do(EQUAL, a, b))
        raise FormulaError("comparisons are < <= > >= == != only")

    def _BoolOp(self, node, depth):
        values = [self._program.truth(self.of(each, depth)) for each in node.values]
        return self._all(AND if isinstance(node.op, ast.And) else OR, values)

    def _all(self, operation, values):
        found = values[0]
        for value in values[1:]:
            found = self._do(operation, found, value)
        return found

    def _IfExp(self, node, depth):
        test, *values = (self.of(each, depth) for each in (node.test, node.body, node.orelse))
        return self._do(SELECT, self._program.truth(test), *values)

    def _Call(self, node, depth):
        name = node.func.id if isinstance(node.func, ast.Name) else None
        if name not in FUNCTIONS and name not in self._tables:
            known = [*FUNCTIONS, *self._tables]
            raise FormulaError(f"unknown function {ast.unparse(node.func)!r:.60}; {suggestion(name, known)}")
        operation, count = FUNCTIONS.get(name, (TABLE, 1))
        if node.keywords or any(isinstance(each, ast.Starred) for each in node.args):
            raise FormulaError(f"{name} takes values only")
        many = name in ("min", "max")
        if len(node.args) != count and not (many and len(node.args) > count):
            raise FormulaError(f"{name} takes {'at least ' if many else ''}{count} values, got {len(node.args)}")
        values = [self.of(each, depth) for each in node.args]
        if many:
            return self._all(operation, values)
        if name == "clip":
            return self._do(MIN, self._do(MAX, values[0], values[1]), values[2])
        if operation == TABLE:
            return self._do(TABLE, values[0], self._tables[name])
        return self._do(operation, *values)


def table_arrays(tables):
    """(begins (k + 1,), points (n, 2)) of tables [(x, y)]."""
    sizes = [len(x) for x, _ in tables]
    points = [point for x, y in tables for point in zip(x, y)]
    return np.cumsum([0, *sizes]).astype(np.int64), np.array(points, dtype=float).reshape(-1, 2)


@kernel
def _power_of_positive(a, b):
    return math.inf if b * math.log(a) > _LARGEST_EXPONENT else a**b


@kernel
def _power(a, b):
    """a^b; NaN for a negative number with an exponent that is not whole."""
    if a > 0.0:
        return _power_of_positive(a, b)
    if a == 0.0:
        return 0.0 if b > 0.0 else (1.0 if b == 0.0 else math.inf)
    if b != math.floor(b):
        return math.nan
    size = _power_of_positive(-a, b)
    return size if b == 2.0 * math.floor(0.5 * b) else -size


@kernel
def _over(a, b):
    """a / b by IEEE 754."""
    if b != 0.0:
        return a / b
    return math.nan if a == 0.0 or a != a else math.copysign(math.inf, a) * math.copysign(1.0, b)


@kernel
def _segment(begins, points, number, x):
    """First point of the segment of a table that has x; -1 before the first point, -2 after the last."""
    low, high = begins[number], begins[number + 1] - 1
    if x < points[low, 0]:
        return -1
    if x >= points[high, 0]:
        return -2
    while high - low > 1:
        middle = (low + high) // 2
        if points[middle, 0] <= x:
            low = middle
        else:
            high = middle
    return low


@kernel
def _slope(points, k):
    return (points[k + 1, 1] - points[k, 1]) / (points[k + 1, 0] - points[k, 0])


@kernel
def branch_of_segment(k):
    """Branch of a segment of a table, see `_segment`."""
    return k + 3.0


@kernel
def _segment_in(begins, points, number, x, branch):
    """Segment of a branch, or that of x."""
    return int(branch) - 3 if abs(branch) >= 1.0 else _segment(begins, points, number, x)


@kernel
def _of_table(begins, points, number, x, branch):
    """Value of a table by linear interpolation; before and after its points that of the end."""
    if x != x:
        return x
    k = _segment_in(begins, points, number, x, branch)
    if k == -1:
        return points[begins[number], 1]
    if k == -2:
        return points[begins[number + 1] - 1, 1]
    return points[k, 1] + _slope(points, k) * (x - points[k, 0])


@kernel
def present_branch(operation, a, b, begins, points, number):
    """Branch of an operation that its arguments are in. At a = b it is that of the value there."""
    if operation == TABLE:
        return branch_of_segment(_segment(begins, points, number, a))
    if operation == ABS:
        b = 0.0
    return ABOVE if a > b or a == b and (operation == LESS or operation == MORE_EQUAL) else BELOW


@kernel
def distances(operation, a, b, branch, begins, points, number):
    """(distance to the lower end of a branch, to the upper end), negative beyond it; infinite: no end."""
    if not abs(branch) >= 1.0:
        return math.inf, math.inf
    if operation == TABLE:
        k = _segment_in(begins, points, number, a, branch)
        if k == -1:
            return math.inf, points[begins[number], 0] - a
        if k == -2:
            return a - points[begins[number + 1] - 1, 0], math.inf
        return a - points[k, 0], points[k + 1, 0] - a
    if branch > 1.0:
        return branch - SHARED, 1.0 - (branch - SHARED)
    way = a if operation == ABS else a - b
    return (way if branch > 0.0 else -way), math.inf


@kernel
def _of_branch(operation, a, b, branch):
    """Value of an operation of two arguments, or of abs, in a branch."""
    if operation == LESS or operation == LESS_EQUAL or operation == MORE or operation == MORE_EQUAL:
        below = branch - SHARED if branch > 1.0 else (0.0 if branch > 0.0 else 1.0)
        return below if operation == LESS or operation == LESS_EQUAL else 1.0 - below
    above = branch > 0.0
    if operation == MIN:
        return b if above else a
    if operation == MAX:
        return a if above else b
    return a if above else -a  # abs


@kernel
def _value(operation, a, b, c, begins, points, number):
    """Value of an operation of a, b and c; number : of the table."""
    if operation == ADD:
        return a + b
    if operation == MULTIPLY:
        return a * b
    if operation == SUBTRACT:
        return a - b
    if operation == NEGATIVE:
        return -a
    if operation == DIVIDE:
        return _over(a, b)
    if operation == SIN:
        return math.sin(a) if abs(a) < math.inf else math.nan
    if operation == COS:
        return math.cos(a) if abs(a) < math.inf else math.nan
    if operation == SELECT:
        return b if a == 1.0 else (c if a == 0.0 else a * b + (1.0 - a) * c)
    if operation == MIN:
        return _of_branch(operation, a, b, c) if abs(c) >= 1.0 else (b if b < a or b != b else a)
    if operation == MAX:
        return _of_branch(operation, a, b, c) if abs(c) >= 1.0 else (b if b > a or b != b else a)
    if operation == LESS:
        return _of_branch(operation, a, b, c) if abs(c) >= 1.0 else (1.0 if a < b else 0.0)
    if operation == LESS_EQUAL:
        return _of_branch(operation, a, b, c) if abs(c) >= 1.0 else (1.0 if a <= b else 0.0)
    if operation == MORE:
        return _of_branch(operation, a, b, c) if abs(c) >= 1.0 else (1.0 if a > b else 0.0)
    if operation == MORE_EQUAL:
        return _of_branch(operation, a, b, c) if abs(c) >= 1.0 else (1.0 if a >= b else 0.0)
    if operation == EQUAL:
        return 1.0 if a == b else 0.0
    if operation == AND:
        return a * b
    if operation == OR:
        return a + (1.0 - a) * b
    if operation == NOT:
        return 1.0 - a
    if operation == ABS:
        return _of_branch(operation, a, b, c) if abs(c) >= 1.0 else abs(a)
    if operation == SQRT:
        return math.sqrt(a) if a >= 0.0 else math.nan
    if operation == EXP:
        return math.inf if a > _LARGEST_EXPONENT else math.exp(a)
    if operation == LOG:
        return math.log(a) if a > 0.0 else (-math.inf if a == 0.0 else math.nan)
    if operation == TANH:
        return math.tanh(a)
    if operation == TAN:
        return math.tan(a) if abs(a) < math.inf else math.nan
    if operation == ATAN2:
        return math.atan2(a, b)
    if operation == ATAN:
        return math.atan(a)
    if operation == ASIN:
        return math.asin(a) if abs(a) <= 1.0 else math.nan
    if operation == ACOS:
        return math.acos(a) if abs(a) <= 1.0 else math.nan
    if operation == POWER:
        return _power(a, b)
    return _of_table(begins, points, number, a, c)


@kernel
def _times(slope, change):
    """Product; zero for no change, also where the slope is infinite."""
    return 0.0 if change == 0.0 else slope * change


@kernel
def _change(operation, value, a, b, c, da, db, dc, begins, points, number):
    """Derivative of an operation whose value is known."""
    if operation == ADD:
        return da + db
    if operation == MULTIPLY:
        return _times(b, da) + _times(a, db)
    if operation == SUBTRACT:
        return da - db
    if operation == NEGATIVE:
        return -da
    if operation == DIVIDE:
        return _over(da - _times(value, db), b)
    if operation == SIN:
        return math.cos(a) * da if abs(a) < math.inf else math.nan
    if operation == COS:
        return -math.sin(a) * da if abs(a) < math.inf else math.nan
    if operation == SELECT:
        return db if a == 1.0 else (dc if a == 0.0 else a * db + (1.0 - a) * dc)
    if operation == MIN or operation == MAX or operation == ABS:
        if abs(c) >= 1.0:
            return _of_branch(operation, da, db, c)
        if operation == ABS:
            return da if a > 0.0 else (-da if a < 0.0 else 0.0)
        other = b < a if operation == MIN else b > a
        return db if other or b != b else da
    if operation == SQRT:
        return _over(0.5 * da, value)
    if operation == EXP:
        return value * da
    if operation == LOG:
        return _over(da, a)
    if operation == TANH:
        return (1.0 - value * value) * da
    if operation == TAN:
        return (1.0 + value * value) * da
    if operation == ATAN2:
        return _over(b * da - a * db, a * a + b * b)
    if operation == ATAN:
        return da / (1.0 + a * a)
    if operation == ASIN or operation == ACOS:
        slope = _over(da, math.sqrt(max((1.0 - a) * (1.0 + a), 0.0)))
        return slope if operation == ASIN else -slope
    if operation == POWER:
        by_base = _times(b * _power(a, b - 1.0), da)
        by_exponent = _times(value * math.log(a), db) if a > 0.0 else (0.0 if db == 0.0 or a == 0.0 else math.nan)
        return by_base + by_exponent
    if operation == TABLE:
        k = _segment_in(begins, points, number, a, c)
        return 0.0 if k < 0 else _slope(points, k) * da
    return 0.0  # a condition


@kernel
def _pass(code, i, registers, columns, fresh):
    """(number of the instruction after a SKIP, `fresh`): see skipping.py; sets the first columns of registers to zero.

    They are zero if the last pass skipped the block, too: its own register tells of each column. But in a block that
    was skipped itself then, up to the instruction `fresh`, inner blocks had no such pass.
    """
    begin, own = i + 1 + code[i, 1], code[i, 4]
    were = registers[own, 0] != 0.0 and registers[own, columns - 1] != 0.0
    are = registers[own, 0] != 0.0 or registers[own, columns - 1] != 0.0
    if registers[code[i, 2], 0] != 0.0:
        registers[own, 0] = registers[own, columns - 1] = 1.0
        return begin, fresh if were else max(fresh, begin + code[i, 3])
    if are or i < fresh:
        for c in range(columns):
            registers[own, c] = 0.0
            for row in range(i + 1, begin):
                for k in range(5):
                    registers[code[row, k], c] = 0.0
    return begin + code[i, 3], fresh


@kernel
def evaluate(code, begins, points, registers, known):
    """Compute the values of all registers (m, 2) that instructions (p, 5) write; begins, points : see table_arrays.

    known : whether nothing else wrote results to this column since the last time
    """
    i, fresh = 0, 0 if known else len(code)
    while i < len(code):
        if code[i, 0] == SKIP:
            i, fresh = _pass(code, i, registers, 1, fresh)
            continue
        a, b, c = code[i, 2], code[i, 3], code[i, 4]
        registers[code[i, 1], 0] = _value(
            code[i, 0], registers[a, 0], registers[b, 0], registers[c, 0], begins, points, b
        )
        i += 1


@kernel
def differentiate(code, begins, points, registers, known):
    """As `evaluate`, also the derivatives along the direction of those of the inputs; known : of both columns."""
    i, fresh = 0, 0 if known else len(code)
    while i < len(code):
        if code[i, 0] == SKIP:
            i, fresh = _pass(code, i, registers, 2, fresh)
            continue
        operation, to, a, b, c = code[i, 0], code[i, 1], code[i, 2], code[i, 3], code[i, 4]
        x, y, z = registers[a, 0], registers[b, 0], registers[c, 0]
        dx, dy, dz = registers[a, 1], registers[b, 1], registers[c, 1]
        value = _value(operation, x, y, z, begins, points, b)
        # The value is stored first, and most derivatives of a direction are zero: that takes a third of the time.
        registers[to, 0] = value
        if dx == 0.0 and dy == 0.0 and dz == 0.0:
            registers[to, 1] = 0.0
        else:
            registers[to, 1] = _change(operation, value, x, y, z, dx, dy, dz, begins, points, b)
        i += 1
