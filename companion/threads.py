"""One thread for the arithmetic libraries."""

import cv2
from threadpoolctl import threadpool_limits


def use_one_thread() -> None:
    """Frames and matrices are small: waking threads costs more than they save, many times more on
    a machine that is busy, and results must not depend on the number of cores.

    Reaches the libraries that are loaded when it is called.
    """
    cv2.setNumThreads(1)
    threadpool_limits(1)
