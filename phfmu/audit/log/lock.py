"""Lock on a log that is being written, so that nobody takes it for what a crash left."""

import errno
import os
import sys

_TAKEN = (errno.EACCES, errno.EAGAIN, errno.EDEADLK)
_FAR = 1 << 62  # Windows locks bytes, also against reading: one that is never there


def try_lock(fd: int, name: str) -> bool:
    """Lock an open file until it is closed or its process ends; False if another process has.

    Where the file system keeps no locks that is said once on stderr, and the file counts as locked.
    """
    try:
        if sys.platform == "win32":
            import msvcrt

            place = os.lseek(fd, 0, os.SEEK_CUR)
            os.lseek(fd, _FAR, os.SEEK_SET)
            try:
                msvcrt.locking(fd, msvcrt.LK_NBLCK, 1)
            finally:
                os.lseek(fd, place, os.SEEK_SET)
        else:
            import fcntl

            fcntl.flock(fd, fcntl.LOCK_EX | fcntl.LOCK_NB)
    except OSError as error:
        if error.errno in _TAKEN:
            return False
        print(
            f"phfmu: {name}: no locks here ({error.strerror}); see to it that nobody else writes or recovers it",
            file=sys.stderr,
        )
    return True
