# SPDX-License-Identifier: Apache-2.0
"""Methods for one rotating body: free, or about a fixed point."""
