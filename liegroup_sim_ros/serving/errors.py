# SPDX-License-Identifier: Apache-2.0
"""Errors of the node."""

from liegroup_core.errors import LieGroupSimError


class NodeParameterError(LieGroupSimError):
    """Invalid parameter; one line of text, exit code 2."""
