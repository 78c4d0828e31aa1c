"""Trust in folders: reasons why others could put files in a folder, or a folder in its place.

What is loaded from a cache runs as the user.  So nobody else may write to it, to its parts, or to a folder above it: who can
write there can move the cache away and put another one there, unless a sticky bit keeps what is in it for its owners, as in /tmp.
"""

from __future__ import annotations

import os
import stat
from functools import cache
from pathlib import Path


def distrust(folder: Path, *parts: Path) -> str | None:
    """Reason why others could change the folder, the parts of it that there are, or a folder above it; None if they could not."""
    if not hasattr(os, "geteuid"):
        return None
    above = dict.fromkeys((*folder.parents, *folder.resolve().parents))
    for part in above:
        if found := _distrust(part, sticky=True):
            return found
    for part in (folder, *parts):
        if found := _distrust(part, sticky=False):
            return found
    return None


def distrust_one(path: Path) -> str | None:
    """Reason not to trust one file in a folder that is trusted, None if there is none."""
    return _distrust(path, sticky=False) if hasattr(os, "geteuid") else None


def _distrust(part: Path, *, sticky: bool) -> str | None:
    """`sticky`: writing to it is harmless where it has that bit."""
    try:
        found = part.stat()
    except OSError:  # it is not there
        return None
    if found.st_uid not in _trusted():
        return f"{part} belongs to another user (uid {found.st_uid})"
    if sticky and found.st_mode & stat.S_ISVTX:
        return None
    if found.st_mode & stat.S_IWOTH:
        return f"anybody can write to {part}"
    if found.st_mode & stat.S_IWGRP and not _is_alone(found.st_gid):
        return f"its group can write to {part} (gid {found.st_gid})"
    return None


def _trusted() -> set[int]:
    """This user and the owner of the root folder, which in a container need not be called root."""
    return {os.geteuid(), 0, Path("/").stat().st_uid}


@cache
def _is_alone(group: int) -> bool:
    """True if a group is the user's own one, which many systems give each user and new folders."""
    import grp
    import pwd

    try:
        user, own = pwd.getpwuid(os.geteuid()), grp.getgrgid(group)
    except KeyError:
        return False
    return own.gr_gid == user.pw_gid and own.gr_name == user.pw_name and set(own.gr_mem) <= {user.pw_name}
