# SPDX-License-Identifier: Apache-2.0
"""Options of subcommands for the settings of a run."""

from liegroup_core.settings import SETTINGS

OF_RUN = tuple(name for name in SETTINGS if name != "estimate")


def add_settings(parser, names=OF_RUN, before="", default=""):
    """Add options for settings of a run; before, default: of their help."""
    for name in names:
        setting = SETTINGS[name]
        usual = default or setting.means or setting.shown_default
        names = f"; {setting.allowed}" if setting.choices else ""
        parser.add_argument(
            f"--{name.replace('_', '-')}",
            type=setting.kind,
            metavar=(setting.unit.upper() or "X") if setting.kind is float else "NAME",
            help=f"{before}{setting.meaning}{names} (default: {usual})",
        )


def given(args, names=OF_RUN):
    """Settings that a command line gives."""
    return {name: getattr(args, name) for name in names if getattr(args, name) is not None}
