# SPDX-License-Identifier: Apache-2.0
"""Confined process: it can read files below given folders, compute, and write to files that are open.

Two mechanisms of the Linux kernel ensure this until the process ends, whatever code it runs:

* Landlock: the process can open only files below the given folders, and only for reading.
* seccomp: only the system calls of `ALLOWED` work. The process cannot create, change or remove files,
  start programs or processes, open sockets, or send signals to other processes.

Source: kernel documentation, userspace-api/landlock and userspace-api/seccomp_filter.
"""

import ctypes
import errno
import os
import platform
import struct

# {machine: its number for seccomp}
MACHINES = {"x86_64": 0xC000003E, "aarch64": 0xC00000B7}
SECCOMP = {"x86_64": 317, "aarch64": 277}
LANDLOCK = 444  # create_ruleset, then add_rule and restrict_self
# System calls with their numbers on x86_64 and aarch64; None: there is no such call.
ALLOWED = {
    "read": (0, 63),
    "write": (1, 64),
    "close": (3, 57),
    "stat": (4, None),
    "fstat": (5, 80),
    "lstat": (6, None),
    "poll": (7, None),
    "ppoll": (271, 73),
    "lseek": (8, 62),
    "mmap": (9, 222),
    "mprotect": (10, 226),
    "munmap": (11, 215),
    "brk": (12, 214),
    "rt_sigaction": (13, 134),
    "rt_sigprocmask": (14, 135),
    "rt_sigreturn": (15, 139),
    "pread64": (17, 67),
    "readv": (19, 65),
    "writev": (20, 66),
    "access": (21, None),
    "sched_yield": (24, 124),
    "mremap": (25, 216),
    "madvise": (28, 233),
    "dup": (32, 23),
    "nanosleep": (35, 101),
    "getpid": (39, 172),
    "exit": (60, 93),
    "uname": (63, 160),
    "getcwd": (79, 17),
    "readlink": (89, None),
    "gettimeofday": (96, 169),
    "getrusage": (98, 165),
    "sysinfo": (99, 179),
    "getuid": (102, 174),
    "getgid": (104, 176),
    "geteuid": (107, 175),
    "getegid": (108, 177),
    "sigaltstack": (131, 132),
    "gettid": (186, 178),
    "futex": (202, 98),
    "sched_getaffinity": (204, 123),
    "getdents64": (217, 61),
    "clock_gettime": (228, 113),
    "clock_getres": (229, 114),
    "clock_nanosleep": (230, 115),
    "exit_group": (231, 94),
    "newfstatat": (262, 79),
    "readlinkat": (267, 78),
    "faccessat": (269, 48),
    "set_robust_list": (273, 99),
    "getrandom": (318, 278),
    "membarrier": (324, 283),
    "statx": (332, 291),
    "rseq": (334, 293),
    "faccessat2": (439, 439),
}
# System calls that are allowed for some values of an argument: (numbers, argument, mask, required bits).
TO_WRITE = os.O_ACCMODE | os.O_CREAT | os.O_TRUNC | (os.O_TMPFILE & ~os.O_DIRECTORY)
CLONE_THREAD = 0x10000
PARTLY = (
    ((2, None), 1, TO_WRITE, 0),  # open
    ((257, 56), 2, TO_WRITE, 0),  # openat
    ((56, 220), 0, CLONE_THREAD, CLONE_THREAD),  # clone
)
# System calls whose second argument selects an operation: (numbers, allowed operations). ioctl: TCGETS, FIOCLEX,
# for Python's open(). fcntl: F_DUPFD, F_GETFD, F_SETFD, F_GETFL, F_DUPFD_CLOEXEC; others can send signals.
CHOSEN = (((16, 29), (0x5401, 0x5451)), ((72, 25), (0, 1, 2, 3, 1030)))
CLONE3 = 435  # refused: its flags are in memory, which seccomp cannot read; the C library then uses clone

_NO_NEW_PRIVILEGES = 38  # of prctl
_READ = (1 << 2) | (1 << 3)  # files, folders
# Kinds of access that each version of Landlock knows, in bits; the last entry serves later versions.
_KNOWN = (0, (1 << 13) - 1, (1 << 14) - 1, (1 << 15) - 1, (1 << 15) - 1, (1 << 16) - 1)
_ALLOW, _KILL, _ERROR = 0x7FFF0000, 0x80000000, 0x00050000
_LOAD, _EQUAL, _AND, _RETURN = 0x20, 0x15, 0x54, 0x06

_libc = ctypes.CDLL(None, use_errno=True)


class Unconfined(Exception):
    """The kernel cannot confine this process; one line of text."""


def confine(folders):
    """Confine this process: it can only read files below `folders`. Raises Unconfined.

    The process must not have started threads. Folders that do not exist are ignored.
    """
    machine = platform.machine()
    if machine not in MACHINES:
        raise Unconfined(f"confinement is available on {' and '.join(MACHINES)} only, not on {machine}")
    if len(os.listdir("/proc/self/task")) > 1:
        raise Unconfined("this process has already started threads")
    if _libc.prctl(_NO_NEW_PRIVILEGES, 1, 0, 0, 0):
        raise Unconfined("the kernel does not know no_new_privs")
    if os.sep not in map(str, folders):
        _restrict_files(folders)
    _restrict_calls(machine)


def _restrict_files(folders):
    """Landlock: allow opening files below the folders only, for reading."""
    version = _libc.syscall(LANDLOCK, None, 0, 1)
    if version < 1:
        raise Unconfined("the kernel has no Landlock (Linux 5.13 or later has it); --allow-files works without it")
    kinds = struct.pack("=Q", _KNOWN[min(version, len(_KNOWN) - 1)])
    rules = _checked(_libc.syscall(LANDLOCK, kinds, len(kinds), 0))
    for folder in folders:
        try:
            place = os.open(folder, os.O_PATH | os.O_CLOEXEC)
        except OSError:
            continue
        allowed = _READ if os.path.isdir(folder) else 1 << 2
        _checked(_libc.syscall(LANDLOCK + 1, rules, 1, struct.pack("=Qi", allowed, place), 0))
        os.close(place)
    _checked(_libc.syscall(LANDLOCK + 2, rules, 0))
    os.close(rules)


def _restrict_calls(machine):
    """seccomp: allow the system calls of the tables, refuse all others with an error."""
    column = list(MACHINES).index(machine)
    # A program of the kernel's packet filter: (operation, jump if true, jump if false, number).
    program = [
        (_LOAD, 0, 0, 4),  # the machine
        (_EQUAL, 1, 0, MACHINES[machine]),
        (_RETURN, 0, 0, _KILL),
        (_LOAD, 0, 0, 0),  # the number of the system call
    ]
    allow, refuse = (_RETURN, 0, 0, _ALLOW), (_RETURN, 0, 0, _ERROR | errno.EPERM)
    for numbers in ALLOWED.values():
        if numbers[column] is not None:
            program += [(_EQUAL, 0, 1, numbers[column]), allow]
    for numbers, argument, mask, wanted in PARTLY:
        if numbers[column] is not None:
            program += [
                (_EQUAL, 0, 5, numbers[column]),
                (_LOAD, 0, 0, 16 + 8 * argument),  # the lower half of the argument
                (_AND, 0, 0, mask),
                (_EQUAL, 0, 1, wanted),
                allow,
                refuse,
            ]
    for numbers, values in CHOSEN:
        program += [(_EQUAL, 0, 2 * len(values) + 2, numbers[column]), (_LOAD, 0, 0, 24)]
        for value in values:
            program += [(_EQUAL, 0, 1, value), allow]
        program += [refuse]
    program += [(_EQUAL, 0, 1, CLONE3), (_RETURN, 0, 0, _ERROR | errno.ENOSYS), refuse]
    code = b"".join(struct.pack("=HBBI", *line) for line in program)
    buffer = ctypes.create_string_buffer(code, len(code))
    filters = struct.pack("@HP", len(program), ctypes.addressof(buffer))
    if _libc.syscall(SECCOMP[machine], 1, 0, filters):
        raise Unconfined(f"the kernel refuses seccomp: {os.strerror(ctypes.get_errno())}")


def _checked(result):
    if result < 0:
        raise Unconfined(f"the kernel refuses Landlock: {os.strerror(ctypes.get_errno())}")
    return result
