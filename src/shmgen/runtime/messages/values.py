"""All the helpers that generated code calls to move values into bytes and back, in one place."""

from __future__ import annotations

from shmgen.runtime.messages.arrays import check_count as check_count
from shmgen.runtime.messages.arrays import count as count
from shmgen.runtime.messages.arrays import each as each
from shmgen.runtime.messages.arrays import each_back as each_back
from shmgen.runtime.messages.arrays import from_numbers as from_numbers
from shmgen.runtime.messages.arrays import numbers as numbers
from shmgen.runtime.messages.explain import ENCODE_ERRORS as ENCODE_ERRORS
from shmgen.runtime.messages.explain import explain as explain
from shmgen.runtime.messages.range_checks import boolean as boolean
from shmgen.runtime.messages.strings import from_latin1 as from_latin1
from shmgen.runtime.messages.strings import from_text as from_text
from shmgen.runtime.messages.strings import from_texts as from_texts
from shmgen.runtime.messages.strings import from_wide as from_wide
from shmgen.runtime.messages.strings import text as text
from shmgen.runtime.messages.strings import text_cut as text_cut
from shmgen.runtime.messages.strings import text_latin1 as text_latin1
from shmgen.runtime.messages.strings import text_latin1_cut as text_latin1_cut
from shmgen.runtime.messages.strings import texts as texts
from shmgen.runtime.messages.strings import wide_text as wide_text
from shmgen.runtime.messages.strings import wide_text_cut as wide_text_cut
from shmgen.runtime.messages.times import Duration as Duration
from shmgen.runtime.messages.times import Time as Time
from shmgen.runtime.messages.times import clock_size as clock_size
from shmgen.runtime.messages.times import clocks as clocks
from shmgen.runtime.messages.times import duration_from_milliseconds as duration_from_milliseconds
from shmgen.runtime.messages.times import duration_from_nanoseconds as duration_from_nanoseconds
from shmgen.runtime.messages.times import duration_from_seconds_nanoseconds as duration_from_seconds_nanoseconds
from shmgen.runtime.messages.times import duration_milliseconds as duration_milliseconds
from shmgen.runtime.messages.times import duration_nanoseconds as duration_nanoseconds
from shmgen.runtime.messages.times import from_clocks as from_clocks
from shmgen.runtime.messages.times import milliseconds as milliseconds
from shmgen.runtime.messages.times import nanoseconds as nanoseconds
from shmgen.runtime.messages.times import seconds_nanoseconds as seconds_nanoseconds
from shmgen.runtime.messages.times import set_clock as set_clock
from shmgen.runtime.messages.times import time_from_milliseconds as time_from_milliseconds
from shmgen.runtime.messages.times import time_from_nanoseconds as time_from_nanoseconds
from shmgen.runtime.messages.times import time_from_seconds_nanoseconds as time_from_seconds_nanoseconds
