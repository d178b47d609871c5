"""Functions and records that compiled functions get as addresses: numbers, which say nothing of their types.

numba compiles a function once for each set of types of its arguments, and reads each argument from Python. A function
that calls others by their addresses is compiled once for all of them, and one that reads a record by its address takes
one argument instead of fifteen.
"""

from __future__ import annotations

import ctypes
import itertools
from collections.abc import Callable, Iterator, Sequence
from typing import Any

import numba
import numpy as np
from numba import extending, types
from numba.core import cgutils
from numba.np import arrayobj

_CONFIG: Any = numba.config

FLOAT, INTEGER, BOOLEAN, NOTHING = numba.float64, numba.int64, numba.boolean, numba.void
VECTOR, MATRIX, MASK = numba.float64[::1], numba.float64[:, ::1], numba.boolean[:, ::1]
INTEGERS, TABLE, BOOLEANS = numba.int64[::1], numba.int64[:, ::1], numba.boolean[::1]


class Signature:
    """Type of compiled functions of which others call a number that they find in a table.

    So a function that evaluates a list of objects, each by a compiled function of its class, is compiled once and not
    for every set of classes.

    Parameters
    ----------
    returned
        Type of the result, such as `NOTHING`, or a tuple of types.
    arguments
        Types of the arguments; of a NamedTuple its `Record`.
    """

    def __init__(self, returned: Any, *arguments: Any) -> None:
        given = [one.type if isinstance(one, Record) else one for one in arguments]
        self._type = (types.Tuple(returned) if isinstance(returned, tuple) else returned)(*given)
        self._addresses: dict[Any, int] = {}

    def table(self, functions: Sequence[Callable[..., Any]]) -> Any:
        """Return the addresses of compiled functions; where numba is disabled, the functions themselves.

        The addresses are those of this process.

        Raises
        ------
        TypeError
            If a function does not have this signature.
        """
        return list(functions) if _CONFIG.DISABLE_JIT else np.array([*map(self._address, functions)], np.int64)

    def _address(self, function: Any) -> int:
        if function in self._addresses:
            return self._addresses[function]
        try:
            made = function.get_compile_result(self._type)
        except AttributeError:
            raise TypeError(f"{function} must be compiled by dqwalk_ros.support.compiled.jit") from None
        except numba.TypingError as error:
            raise TypeError(f"{function.py_func.__qualname__} is not of the type {self._type}: {error}") from error
        found, wanted = made.signature.return_type, self._type.return_type
        if found != wanted:
            raise TypeError(f"{function.py_func.__qualname__} returns {found}, but must return {wanted}")
        address: int = made.library.get_pointer_to_function(made.fndesc.llvm_func_name)
        self._addresses[function] = address
        return address

    @property
    def call(self) -> Any:
        """Compiled function that calls the function of an entry of a table: call(entry, *arguments)."""
        if _CONFIG.DISABLE_JIT:
            return lambda function, *arguments: function(*arguments)
        called = self._type

        @extending.intrinsic
        def call(typing: Any, entry: Any, *arguments: Any) -> Any:
            def generated(context: Any, builder: Any, _: Any, values: Any) -> Any:
                convention, (address, given) = context.call_conv, values
                type_ = convention.get_function_type(called.return_type, called.args)
                pointer = builder.inttoptr(address, type_.as_pointer())
                given = cgutils.unpack_tuple(builder, given)
                status, result = convention.call_function(builder, pointer, called.return_type, called.args, given)
                with cgutils.if_unlikely(builder, status.is_error):
                    convention.return_status_propagate(builder, status)
                return result

            return called.return_type(INTEGER, types.BaseTuple.from_types(called.args)), generated

        return call


class Record:
    """Type of a NamedTuple of arrays and numbers, for a `Signature`, or for a function that takes it by its address.

    numba reads 15 arrays in a microsecond from Python. So a record that is made once is read once, into a table, which
    is one array; of it the compiled function makes the record again, without time.

    Parameters
    ----------
    fields
        Types of its arrays and numbers, such as `VECTOR`; of a record within it, its `Record`.
    """

    def __init__(self, cls: type[tuple[Any, ...]], *fields: Any) -> None:
        self._fields = [(field, np.dtype(str(field.dtype)) if hasattr(field, "dtype") else None) for field in fields]
        self.type: Any = types.NamedTuple([field.type if isinstance(field, Record) else field for field in fields], cls)

    def table(self, record: tuple[Any, ...]) -> Any:
        """Return the numbers, and address and shape of each array, as long as the arrays exist.

        Where numba is disabled, it is the record.

        Raises
        ------
        TypeError
            If an array is of another type.
        """
        return record if _CONFIG.DISABLE_JIT else np.array(self._words(record), np.int64)

    def _words(self, record: tuple[Any, ...]) -> list[int]:
        words: list[int] = []
        for (field, dtype), part in zip(self._fields, record, strict=True):
            if isinstance(field, Record):
                words += field._words(part)
            elif dtype is None:
                words.append(int(np.float64(part).view(np.int64)) if field is FLOAT else int(part))
            elif part.dtype != dtype or part.ndim != field.ndim or not part.flags.c_contiguous:
                raise TypeError(f"an array of {self.type.instance_class.__name__} is {numba.typeof(part)}, not {field}")
            else:
                address = ctypes.addressof(ctypes.c_char.from_buffer(part)) if part.size else 0
                words += address, *part.shape
        return words

    @property
    def opened(self) -> Any:
        """Compiled function that returns the record of a table."""
        if _CONFIG.DISABLE_JIT:
            return lambda record: record

        @extending.intrinsic
        def opened(typing: Any, table: Any) -> Any:
            def generated(context: Any, builder: Any, signature: Any, values: Any) -> Any:
                words = context.make_array(table)(context, builder, values[0]).data
                return self._read(context, builder, words, itertools.count())

            return self.type(table), generated

        return opened

    def _read(self, context: Any, builder: Any, words: Any, places: Iterator[int]) -> Any:
        """Return the code that makes the record of the next words of a table."""

        def word() -> Any:
            return builder.load(builder.gep(words, [context.get_constant(types.intp, next(places))]))

        parts = []
        for field, dtype in self._fields:
            if isinstance(field, Record):
                parts.append(field._read(context, builder, words, places))
                continue
            if dtype is None:
                as_value = {FLOAT: builder.bitcast, INTEGER: builder.bitcast, BOOLEAN: builder.trunc}[field]
                parts.append(as_value(word(), context.get_value_type(field)))
                continue
            array = context.make_array(field)(context, builder)
            size = context.get_constant(types.intp, dtype.itemsize)
            data, shape = builder.inttoptr(word(), array.data.type), [word() for _ in range(field.ndim)]
            strides = [size]
            for length in shape[:0:-1]:
                strides.insert(0, builder.mul(strides[0], length))
            arrayobj.populate_array(array, data, shape, strides, size, meminfo=None)
            parts.append(array._getvalue())
        return context.make_tuple(builder, self.type, parts)
