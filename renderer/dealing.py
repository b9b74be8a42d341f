"""Work dealt to threads item by item: who is done takes the next, so that none waits long for another.

Which thread takes an item is chance; no bit depends on it, for an item's pixels are no other's.
"""

import threading
from typing import Any, cast

import numpy as np
from numba.core import config, types
from numba.extending import intrinsic as _intrinsic

from termwise.renderer.jit import device

# pyright believes that an intrinsic is called with its typing context.
intrinsic = cast(Any, _intrinsic)
_LOCK = threading.Lock()


def _counted_up(dealt: np.ndarray) -> int:
    """`deal` of plain Python, whose threads change places between any two of its steps."""
    with _LOCK:
        item = int(dealt[0])
        dealt[0] = item + 1
    return item


@intrinsic
def _fetched_and_added(typingctx: Any, array: Any) -> Any:
    """The first entry of an int64 array before 1 is added to it, at one stroke."""
    if not (isinstance(array, types.Array) and array.dtype == types.int64):
        return None

    def codegen(context: Any, builder: Any, sig: Any, args: Any) -> Any:
        data = context.make_array(sig.args[0])(context, builder, args[0]).data
        return builder.atomic_rmw("add", data, context.get_constant(types.int64, 1), "monotonic")

    return types.int64(array), codegen


@device
def _dealt(dealt: np.ndarray) -> int:
    return _fetched_and_added(dealt)


deal = _counted_up if cast(Any, config).DISABLE_JIT else _dealt
"""deal(dealt) -> the number of the next item; `dealt` (1,) int64, how many were taken, is shared by all threads."""
