"""A file out of a browser's form, written to disk as it comes and stopped at its bound."""

from __future__ import annotations

from collections.abc import AsyncIterator, Callable
from dataclasses import dataclass, field
from pathlib import Path
from typing import BinaryIO

from jointid.apps.web.limits import megabytes
from jointid.apps.web.names import safe_name
from jointid.apps.web.sessions import PageError

_LARGEST_FORM = 64 * 2**10  # bytes of a form around its file


@dataclass(slots=True)
class _Form:
    """The parts of a multipart form as they arrive; the first that is a file is written."""

    path: Path
    bound: int
    accept: Callable[[str], object]
    name: str = ""
    size: int = 0
    whole: bool = False
    _header: bytes = b""
    _value: bytes = b""
    _headers: dict[bytes, bytes] = field(default_factory=dict)
    _file: BinaryIO | None = None

    def begin(self) -> None:
        self._headers.clear()

    def header_name(self, data: bytes, start: int, end: int) -> None:
        self._header += data[start:end]

    def header_value(self, data: bytes, start: int, end: int) -> None:
        self._value += data[start:end]

    def header_end(self) -> None:
        self._headers[self._header.lower()] = self._value
        self._header = self._value = b""

    def headers_end(self) -> None:
        from python_multipart.multipart import parse_options_header

        _, options = parse_options_header(self._headers.get(b"content-disposition", b""))
        raw = options.get(b"filename", b"").decode("utf-8", errors="replace").replace("%22", '"')  # so forms quote it
        if raw and not self.name:
            self.name = safe_name(raw, "record")
            self.accept(self.name)
            self._file = self.path.open("wb")

    def data(self, data: bytes, start: int, end: int) -> None:
        if self._file is None:
            return
        self.size += end - start
        if self.size > self.bound:
            raise PageError(too_large(self.name, self.bound))
        self._file.write(data[start:end])

    def all_parts(self) -> None:
        self.whole = True

    def end(self) -> None:
        if self._file is not None:
            self._file.close()
            self._file = None


def too_large(name: str, bound: int) -> str:
    """Return the sentence on a file beyond its bound."""
    return f"{name} is larger than {megabytes(bound)}, which is the most this page takes; cut it, or log it slower."


async def received(
    chunks: AsyncIterator[bytes], content_type: str, path: Path, bound: int, accept: Callable[[str], object]
) -> str:
    """Write the file of a form, and return its name, made safe; what was written of one that is refused is removed.

    Args:
        chunks: the body of the request.
        content_type: of the request, which has the form's boundary.
        path: to write to.
        bound: bytes of the file, at most.
        accept: is told the name before anything is written, and may refuse it.

    Raises:
        PageError: the form has no file, one that is too large, or is damaged.
        JointidError: what `accept` raises.
    """
    from python_multipart.exceptions import FormParserError
    from python_multipart.multipart import MultipartParser, parse_options_header

    kind, options = parse_options_header(content_type)
    if kind != b"multipart/form-data" or b"boundary" not in options:
        raise PageError("The request holds no form with a file; choose a file on the page.")
    form = _Form(path, bound, accept)
    try:
        parser = MultipartParser(
            options[b"boundary"],
            {
                "on_part_begin": form.begin,
                "on_header_field": form.header_name,
                "on_header_value": form.header_value,
                "on_header_end": form.header_end,
                "on_headers_finished": form.headers_end,
                "on_part_data": form.data,
                "on_part_end": form.end,
                "on_end": form.all_parts,
            },
        )
        total = 0
        async for chunk in chunks:
            total += len(chunk)
            if total > bound + _LARGEST_FORM:
                raise PageError(too_large(form.name or "The form", bound))
            parser.write(chunk)
        if not form.whole:
            raise PageError("The file did not arrive whole; send it again.")
        if not form.name:
            raise PageError("No file was chosen; choose one first.")
    except FormParserError:
        path.unlink(missing_ok=True)
        raise PageError("The file did not arrive whole; send it again.") from None
    except BaseException:  # the visitor may have gone in the middle: nothing of it is kept
        path.unlink(missing_ok=True)
        raise
    finally:
        form.end()
    return form.name
