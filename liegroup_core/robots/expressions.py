# SPDX-License-Identifier: Apache-2.0
"""Expressions of xacro files, `${...}` and `$(eval ...)`, checked before they are evaluated.

Allowed are numbers, texts, lists, mappings, names, operators, conditions, calls, elements, and the
attributes of `_attribute`. Lambdas and comprehensions are refused, because they contain code.
"""

import ast
import math
import operator
import re
import string

# Methods of these types only compute values. `format` is replaced, because Python's own one reads attributes.
METHODS = {
    kind: {name for name in dir(kind) if not name.startswith("_")} - {"format_map"} for kind in (str, dict, list, tuple)
}
_KINDS = (
    "Expression Constant Name expr_context List Tuple Set Dict Subscript Slice BoolOp boolop BinOp operator UnaryOp "
    "unaryop Compare cmpop IfExp Call keyword Starred Attribute"
)
NODES = tuple(getattr(ast, kind) for kind in _KINDS.split())
# Names of other nodes in error messages.
CODE = {"Lambda": "lambda", "ListComp": "comprehension", "SetComp": "comprehension"}
CODE |= {"DictComp": "comprehension", "GeneratorExp": "comprehension", "NamedExpr": "assignment"}
CODE |= {"JoinedStr": "f-string"}
_GET, _CALL, _OPERATE = ".attribute", ".call", ".operate"  # cannot be names in an expression
LARGEST, DIGITS = 10**6, 300  # length of a text, list or count; of a whole number, beyond those of a float
_OPERATIONS = {ast.Pow: operator.pow, ast.Mult: operator.mul, ast.LShift: operator.lshift, ast.Add: operator.add}
_OPERATIONS |= {ast.Mod: operator.mod}
_FACTORIALS = ("factorial", "perm", "comb")
_WIDE = tuple("pow range ljust rjust center zfill expandtabs round".split())


class RefusedExpression(Exception):
    """Expression that xacro files must not contain; one line of text."""


def evaluate(text, symbols, spaces):
    """Value of an expression.

    symbols : mapping of names to values
    spaces  : classes of mappings whose entries are also attributes, such as `math` in `math.pi`
    raises RefusedExpression, SyntaxError, and what the operations raise
    """
    tree = ast.parse(text.strip(), "<expression>", "eval")
    for node in ast.walk(tree):
        if not isinstance(node, NODES):
            kind = CODE.get(type(node).__name__, type(node).__name__)
            raise RefusedExpression(f"{kind} in an expression is not allowed: write the values out")
        name = getattr(node, "id", None) or getattr(node, "attr", None) or getattr(node, "arg", "")
        if (name or "").startswith("__"):
            raise RefusedExpression(f"the name {name:.60} is not allowed: names must not begin with __")
    code = compile(ast.fix_missing_locations(_Attributes().visit(tree)), "<expression>", "eval")
    get = _attribute(spaces)
    # Without the key __builtins__, Python would add its own.
    return eval(code, {"__builtins__": {}, _GET: get, _CALL: _call, _OPERATE: _operate}, symbols)


def _bounded(is_small):
    if not is_small:
        raise RefusedExpression(f"a text or list longer than {LARGEST}, or a whole number of more than {DIGITS} digits")


def _operate(kind, a, b):
    """Result of an operation whose size is bounded before it is computed."""
    operation, most = getattr(operator, kind), 3 * DIGITS
    if isinstance(a, int) and isinstance(b, int):
        bits = a.bit_length()
        size = {"pow": bits * abs(b), "lshift": bits + b, "mul": bits + b.bit_length()}.get(kind, 0)
        _bounded(size <= most)
    elif kind == "mul":
        _bounded(
            all(
                not hasattr(x, "__len__") or len(x) * (n if isinstance(n, int) else 1) <= LARGEST
                for x, n in ((a, b), (b, a))
            )
        )
    elif kind == "mod" and isinstance(a, str):
        _check_widths(a.replace("*", str(LARGEST)))
    elif hasattr(a, "__len__") and hasattr(b, "__len__"):
        _bounded(len(a) + len(b) <= LARGEST)
    return operation(a, b)


def _check_widths(text):
    _bounded(all(len(digits) < 4 for digits in re.findall("[0-9]+", text)))


def _call(function, *given, **named):
    """Result of a call; factorials and texts of a width grow with their arguments, replaced texts with both."""
    name, own = getattr(function, "__name__", ""), getattr(function, "__self__", None)
    if name in _FACTORIALS + _WIDE:
        most = 100 if name in _FACTORIALS else LARGEST
        _bounded(all(abs(x) <= most for x in given if isinstance(x, int)))
    if name in ("replace", "join") and isinstance(own, str):
        more = given[1:2] if name == "replace" else given[:1]
        _bounded(math.prod(sum(map(len, map(str, x))) + 1 for x in (own, *more)) <= LARGEST)
    return function(*given, **named)


class _Attributes(ast.NodeTransformer):
    """Replaces attributes, calls and operations that grow by calls of `_attribute`, `_call` and `_operate`."""

    def visit_Call(self, node):
        self.generic_visit(node)
        call = ast.Call(ast.Name(_CALL, ast.Load()), [node.func, *node.args], node.keywords)
        return ast.copy_location(call, node)

    def visit_BinOp(self, node):
        self.generic_visit(node)
        if type(node.op) not in _OPERATIONS:
            return node
        name = ast.Constant(_OPERATIONS[type(node.op)].__name__)
        return ast.copy_location(ast.Call(ast.Name(_OPERATE, ast.Load()), [name, node.left, node.right], []), node)

    def visit_Attribute(self, node):
        self.generic_visit(node)
        get = ast.Name(_GET, ast.Load())
        return ast.copy_location(ast.Call(get, [node.value, ast.Constant(node.attr)], []), node)


def _attribute(spaces):
    def get(value, name):
        """Entry of a namespace, or an allowed method of a text, list or mapping."""
        known = next((names for kind, names in METHODS.items() if isinstance(value, kind)), ())
        if isinstance(value, spaces) and (name in value or name not in known):
            if name not in value:
                raise NameError(f"name {name!r:.60} is not defined")
            return value[name]
        if name not in known:
            raise RefusedExpression(f"the attribute {name:.60} of a {type(value).__name__} is not allowed")
        if name == "format":
            return lambda *given, **named: _Formatter().vformat(value, given, named)
        return getattr(value, name)

    return get


class _Formatter(string.Formatter):
    """Formatter for {} and {name}; it refuses attributes and elements of values, and widths of four digits."""

    def format_field(self, value, format_spec):
        _check_widths(format_spec)
        return super().format_field(value, format_spec)

    def get_field(self, field_name, args, kwargs):
        if "." in field_name or "[" in field_name:
            raise RefusedExpression(f"{{{field_name:.60}}} in a format is not allowed: give the value itself")
        return super().get_field(field_name, args, kwargs)
