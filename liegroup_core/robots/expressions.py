# SPDX-License-Identifier: Apache-2.0
"""Expressions of xacro files, `${...}` and `$(eval ...)`, checked before they are evaluated.

Allowed are numbers, texts, lists, mappings, names, operators, conditions, calls, elements, and the
attributes of `_attribute`. Lambdas and comprehensions are refused, because they contain code.
"""

import ast
import string

# Methods of these types only compute values. `format` is replaced, because Python's own one reads attributes.
METHODS = {
    kind: {name for name in dir(kind) if not name.startswith("_")} - {"format_map"} for kind in (str, dict, list, tuple)
}
NODES = (
    ast.Expression,
    ast.Constant,
    ast.Name,
    ast.expr_context,
    ast.List,
    ast.Tuple,
    ast.Set,
    ast.Dict,
    ast.Subscript,
    ast.Slice,
    ast.BoolOp,
    ast.boolop,
    ast.BinOp,
    ast.operator,
    ast.UnaryOp,
    ast.unaryop,
    ast.Compare,
    ast.cmpop,
    ast.IfExp,
    ast.Call,
    ast.keyword,
    ast.Starred,
    ast.Attribute,
)
# Names of other nodes in error messages.
CODE = {"Lambda": "lambda", "ListComp": "comprehension", "SetComp": "comprehension"}
CODE |= {"DictComp": "comprehension", "GeneratorExp": "comprehension", "NamedExpr": "assignment"}
CODE |= {"JoinedStr": "f-string"}
_GET = ".attribute"  # cannot be a name in an expression


class Refused(Exception):
    """Expression that xacro files must not contain; one line of text."""


def evaluate(text, symbols, spaces):
    """Value of an expression.

    symbols : mapping of names to values
    spaces  : classes of mappings whose entries are also attributes, such as `math` in `math.pi`
    raises Refused, SyntaxError, and what the operations raise
    """
    tree = ast.parse(text.strip(), "<expression>", "eval")
    for node in ast.walk(tree):
        if not isinstance(node, NODES):
            kind = CODE.get(type(node).__name__, type(node).__name__)
            raise Refused(f"{kind} in an expression is not allowed: write the values out")
        name = getattr(node, "id", None) or getattr(node, "attr", None) or getattr(node, "arg", "")
        if (name or "").startswith("__"):
            raise Refused(f"the name {name:.60} is not allowed: names must not begin with __")
    code = compile(ast.fix_missing_locations(_Attributes().visit(tree)), "<expression>", "eval")
    get = _attribute(spaces)
    # Without the key __builtins__, Python would add its own.
    return eval(code, {"__builtins__": {}, _GET: get}, symbols)


class _Attributes(ast.NodeTransformer):
    """Replaces attributes by calls of `_attribute`."""

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
            raise Refused(f"the attribute {name:.60} of a {type(value).__name__} is not allowed")
        if name == "format":
            return lambda *given, **named: _Formatter().vformat(value, given, named)
        return getattr(value, name)

    return get


class _Formatter(string.Formatter):
    """Formatter for {} and {name}; it refuses attributes and elements of values."""

    def get_field(self, field_name, args, kwargs):
        if "." in field_name or "[" in field_name:
            raise Refused(f"{{{field_name:.60}}} in a format is not allowed: give the value itself")
        return super().get_field(field_name, args, kwargs)
