from google.protobuf.internal import containers as _containers
from google.protobuf.internal import enum_type_wrapper as _enum_type_wrapper
from google.protobuf import descriptor as _descriptor
from google.protobuf import message as _message
from collections.abc import Iterable as _Iterable, Mapping as _Mapping
from typing import ClassVar as _ClassVar, Optional as _Optional, Union as _Union

DESCRIPTOR: _descriptor.FileDescriptor

class Begin(_message.Message):
    __slots__ = ("format", "files", "names", "provenance", "converter")
    class FilesEntry(_message.Message):
        __slots__ = ("key", "value")
        KEY_FIELD_NUMBER: _ClassVar[int]
        VALUE_FIELD_NUMBER: _ClassVar[int]
        key: str
        value: bytes
        def __init__(self, key: _Optional[str] = ..., value: _Optional[bytes] = ...) -> None: ...
    class NamesEntry(_message.Message):
        __slots__ = ("key", "value")
        KEY_FIELD_NUMBER: _ClassVar[int]
        VALUE_FIELD_NUMBER: _ClassVar[int]
        key: str
        value: str
        def __init__(self, key: _Optional[str] = ..., value: _Optional[str] = ...) -> None: ...
    FORMAT_FIELD_NUMBER: _ClassVar[int]
    FILES_FIELD_NUMBER: _ClassVar[int]
    NAMES_FIELD_NUMBER: _ClassVar[int]
    PROVENANCE_FIELD_NUMBER: _ClassVar[int]
    CONVERTER_FIELD_NUMBER: _ClassVar[int]
    format: int
    files: _containers.ScalarMap[str, bytes]
    names: _containers.ScalarMap[str, str]
    provenance: str
    converter: Converter
    def __init__(self, format: _Optional[int] = ..., files: _Optional[_Mapping[str, bytes]] = ..., names: _Optional[_Mapping[str, str]] = ..., provenance: _Optional[str] = ..., converter: _Optional[_Union[Converter, _Mapping]] = ...) -> None: ...

class Converter(_message.Message):
    __slots__ = ("bits", "range", "volts_per_tesla", "gains")
    BITS_FIELD_NUMBER: _ClassVar[int]
    RANGE_FIELD_NUMBER: _ClassVar[int]
    VOLTS_PER_TESLA_FIELD_NUMBER: _ClassVar[int]
    GAINS_FIELD_NUMBER: _ClassVar[int]
    bits: int
    range: float
    volts_per_tesla: float
    gains: _containers.RepeatedScalarFieldContainer[float]
    def __init__(self, bits: _Optional[int] = ..., range: _Optional[float] = ..., volts_per_tesla: _Optional[float] = ..., gains: _Optional[_Iterable[float]] = ...) -> None: ...

class Window(_message.Message):
    __slots__ = ("actuate", "excite", "ring_down", "listen", "rest", "rotate", "move_magnet")
    class Actuate(_message.Message):
        __slots__ = ("currents", "duration")
        CURRENTS_FIELD_NUMBER: _ClassVar[int]
        DURATION_FIELD_NUMBER: _ClassVar[int]
        currents: _containers.RepeatedScalarFieldContainer[float]
        duration: float
        def __init__(self, currents: _Optional[_Iterable[float]] = ..., duration: _Optional[float] = ...) -> None: ...
    class Excite(_message.Message):
        __slots__ = ("x", "y", "frequency", "cycles")
        X_FIELD_NUMBER: _ClassVar[int]
        Y_FIELD_NUMBER: _ClassVar[int]
        FREQUENCY_FIELD_NUMBER: _ClassVar[int]
        CYCLES_FIELD_NUMBER: _ClassVar[int]
        x: float
        y: float
        frequency: float
        cycles: int
        def __init__(self, x: _Optional[float] = ..., y: _Optional[float] = ..., frequency: _Optional[float] = ..., cycles: _Optional[int] = ...) -> None: ...
    class RingDown(_message.Message):
        __slots__ = ("duration",)
        DURATION_FIELD_NUMBER: _ClassVar[int]
        duration: float
        def __init__(self, duration: _Optional[float] = ...) -> None: ...
    class Listen(_message.Message):
        __slots__ = ("half_periods", "frequency")
        HALF_PERIODS_FIELD_NUMBER: _ClassVar[int]
        FREQUENCY_FIELD_NUMBER: _ClassVar[int]
        half_periods: int
        frequency: float
        def __init__(self, half_periods: _Optional[int] = ..., frequency: _Optional[float] = ...) -> None: ...
    class Rest(_message.Message):
        __slots__ = ("duration",)
        DURATION_FIELD_NUMBER: _ClassVar[int]
        duration: float
        def __init__(self, duration: _Optional[float] = ...) -> None: ...
    class Rotate(_message.Message):
        __slots__ = ("x", "y", "z", "frequency", "turns")
        X_FIELD_NUMBER: _ClassVar[int]
        Y_FIELD_NUMBER: _ClassVar[int]
        Z_FIELD_NUMBER: _ClassVar[int]
        FREQUENCY_FIELD_NUMBER: _ClassVar[int]
        TURNS_FIELD_NUMBER: _ClassVar[int]
        x: float
        y: float
        z: float
        frequency: float
        turns: float
        def __init__(self, x: _Optional[float] = ..., y: _Optional[float] = ..., z: _Optional[float] = ..., frequency: _Optional[float] = ..., turns: _Optional[float] = ...) -> None: ...
    class MoveMagnet(_message.Message):
        __slots__ = ("near", "expected_duration")
        NEAR_FIELD_NUMBER: _ClassVar[int]
        EXPECTED_DURATION_FIELD_NUMBER: _ClassVar[int]
        near: bool
        expected_duration: float
        def __init__(self, near: _Optional[bool] = ..., expected_duration: _Optional[float] = ...) -> None: ...
    ACTUATE_FIELD_NUMBER: _ClassVar[int]
    EXCITE_FIELD_NUMBER: _ClassVar[int]
    RING_DOWN_FIELD_NUMBER: _ClassVar[int]
    LISTEN_FIELD_NUMBER: _ClassVar[int]
    REST_FIELD_NUMBER: _ClassVar[int]
    ROTATE_FIELD_NUMBER: _ClassVar[int]
    MOVE_MAGNET_FIELD_NUMBER: _ClassVar[int]
    actuate: Window.Actuate
    excite: Window.Excite
    ring_down: Window.RingDown
    listen: Window.Listen
    rest: Window.Rest
    rotate: Window.Rotate
    move_magnet: Window.MoveMagnet
    def __init__(self, actuate: _Optional[_Union[Window.Actuate, _Mapping]] = ..., excite: _Optional[_Union[Window.Excite, _Mapping]] = ..., ring_down: _Optional[_Union[Window.RingDown, _Mapping]] = ..., listen: _Optional[_Union[Window.Listen, _Mapping]] = ..., rest: _Optional[_Union[Window.Rest, _Mapping]] = ..., rotate: _Optional[_Union[Window.Rotate, _Mapping]] = ..., move_magnet: _Optional[_Union[Window.MoveMagnet, _Mapping]] = ...) -> None: ...

class Shot(_message.Message):
    __slots__ = ("number", "mode", "start", "ended", "windows", "heard")
    NUMBER_FIELD_NUMBER: _ClassVar[int]
    MODE_FIELD_NUMBER: _ClassVar[int]
    START_FIELD_NUMBER: _ClassVar[int]
    ENDED_FIELD_NUMBER: _ClassVar[int]
    WINDOWS_FIELD_NUMBER: _ClassVar[int]
    HEARD_FIELD_NUMBER: _ClassVar[int]
    number: int
    mode: str
    start: float
    ended: float
    windows: _containers.RepeatedCompositeFieldContainer[Window]
    heard: bool
    def __init__(self, number: _Optional[int] = ..., mode: _Optional[str] = ..., start: _Optional[float] = ..., ended: _Optional[float] = ..., windows: _Optional[_Iterable[_Union[Window, _Mapping]]] = ..., heard: _Optional[bool] = ...) -> None: ...

class Samples(_message.Message):
    __slots__ = ("number", "clock", "sample_rate", "time_since_drive", "sensors", "saturated", "scaling", "counts", "field")
    class Scaling(int, metaclass=_enum_type_wrapper.EnumTypeWrapper):
        __slots__ = ()
        FIELD: _ClassVar[Samples.Scaling]
        TESLA: _ClassVar[Samples.Scaling]
        VOLTS: _ClassVar[Samples.Scaling]
        BOTH: _ClassVar[Samples.Scaling]
    FIELD: Samples.Scaling
    TESLA: Samples.Scaling
    VOLTS: Samples.Scaling
    BOTH: Samples.Scaling
    NUMBER_FIELD_NUMBER: _ClassVar[int]
    CLOCK_FIELD_NUMBER: _ClassVar[int]
    SAMPLE_RATE_FIELD_NUMBER: _ClassVar[int]
    TIME_SINCE_DRIVE_FIELD_NUMBER: _ClassVar[int]
    SENSORS_FIELD_NUMBER: _ClassVar[int]
    SATURATED_FIELD_NUMBER: _ClassVar[int]
    SCALING_FIELD_NUMBER: _ClassVar[int]
    COUNTS_FIELD_NUMBER: _ClassVar[int]
    FIELD_FIELD_NUMBER: _ClassVar[int]
    number: int
    clock: float
    sample_rate: float
    time_since_drive: float
    sensors: int
    saturated: _containers.RepeatedScalarFieldContainer[int]
    scaling: Samples.Scaling
    counts: bytes
    field: bytes
    def __init__(self, number: _Optional[int] = ..., clock: _Optional[float] = ..., sample_rate: _Optional[float] = ..., time_since_drive: _Optional[float] = ..., sensors: _Optional[int] = ..., saturated: _Optional[_Iterable[int]] = ..., scaling: _Optional[_Union[Samples.Scaling, str]] = ..., counts: _Optional[bytes] = ..., field: _Optional[bytes] = ...) -> None: ...

class Pose(_message.Message):
    __slots__ = ("number", "time", "position", "orientation", "covariance", "r_squared", "flip_margin", "trusted")
    NUMBER_FIELD_NUMBER: _ClassVar[int]
    TIME_FIELD_NUMBER: _ClassVar[int]
    POSITION_FIELD_NUMBER: _ClassVar[int]
    ORIENTATION_FIELD_NUMBER: _ClassVar[int]
    COVARIANCE_FIELD_NUMBER: _ClassVar[int]
    R_SQUARED_FIELD_NUMBER: _ClassVar[int]
    FLIP_MARGIN_FIELD_NUMBER: _ClassVar[int]
    TRUSTED_FIELD_NUMBER: _ClassVar[int]
    number: int
    time: float
    position: _containers.RepeatedScalarFieldContainer[float]
    orientation: _containers.RepeatedScalarFieldContainer[float]
    covariance: _containers.RepeatedScalarFieldContainer[float]
    r_squared: float
    flip_margin: float
    trusted: bool
    def __init__(self, number: _Optional[int] = ..., time: _Optional[float] = ..., position: _Optional[_Iterable[float]] = ..., orientation: _Optional[_Iterable[float]] = ..., covariance: _Optional[_Iterable[float]] = ..., r_squared: _Optional[float] = ..., flip_margin: _Optional[float] = ..., trusted: _Optional[bool] = ...) -> None: ...

class Truth(_message.Message):
    __slots__ = ("number", "pose", "end", "way")
    NUMBER_FIELD_NUMBER: _ClassVar[int]
    POSE_FIELD_NUMBER: _ClassVar[int]
    END_FIELD_NUMBER: _ClassVar[int]
    WAY_FIELD_NUMBER: _ClassVar[int]
    number: int
    pose: Pose
    end: Pose
    way: _containers.RepeatedScalarFieldContainer[float]
    def __init__(self, number: _Optional[int] = ..., pose: _Optional[_Union[Pose, _Mapping]] = ..., end: _Optional[_Union[Pose, _Mapping]] = ..., way: _Optional[_Iterable[float]] = ...) -> None: ...

class Command(_message.Message):
    __slots__ = ("number", "windows", "several", "saturated", "note", "progress", "phase", "done", "stuck", "event")
    NUMBER_FIELD_NUMBER: _ClassVar[int]
    WINDOWS_FIELD_NUMBER: _ClassVar[int]
    SEVERAL_FIELD_NUMBER: _ClassVar[int]
    SATURATED_FIELD_NUMBER: _ClassVar[int]
    NOTE_FIELD_NUMBER: _ClassVar[int]
    PROGRESS_FIELD_NUMBER: _ClassVar[int]
    PHASE_FIELD_NUMBER: _ClassVar[int]
    DONE_FIELD_NUMBER: _ClassVar[int]
    STUCK_FIELD_NUMBER: _ClassVar[int]
    EVENT_FIELD_NUMBER: _ClassVar[int]
    number: int
    windows: _containers.RepeatedCompositeFieldContainer[Window]
    several: bool
    saturated: bool
    note: str
    progress: float
    phase: str
    done: bool
    stuck: bool
    event: str
    def __init__(self, number: _Optional[int] = ..., windows: _Optional[_Iterable[_Union[Window, _Mapping]]] = ..., several: _Optional[bool] = ..., saturated: _Optional[bool] = ..., note: _Optional[str] = ..., progress: _Optional[float] = ..., phase: _Optional[str] = ..., done: _Optional[bool] = ..., stuck: _Optional[bool] = ..., event: _Optional[str] = ...) -> None: ...

class Timing(_message.Message):
    __slots__ = ("number", "shot", "ended", "compute", "rig", "has_pose", "has_tracked", "wall")
    NUMBER_FIELD_NUMBER: _ClassVar[int]
    SHOT_FIELD_NUMBER: _ClassVar[int]
    ENDED_FIELD_NUMBER: _ClassVar[int]
    COMPUTE_FIELD_NUMBER: _ClassVar[int]
    RIG_FIELD_NUMBER: _ClassVar[int]
    HAS_POSE_FIELD_NUMBER: _ClassVar[int]
    HAS_TRACKED_FIELD_NUMBER: _ClassVar[int]
    WALL_FIELD_NUMBER: _ClassVar[int]
    number: int
    shot: int
    ended: float
    compute: float
    rig: str
    has_pose: bool
    has_tracked: bool
    wall: float
    def __init__(self, number: _Optional[int] = ..., shot: _Optional[int] = ..., ended: _Optional[float] = ..., compute: _Optional[float] = ..., rig: _Optional[str] = ..., has_pose: _Optional[bool] = ..., has_tracked: _Optional[bool] = ..., wall: _Optional[float] = ...) -> None: ...

class Event(_message.Message):
    __slots__ = ("time", "what", "detail")
    TIME_FIELD_NUMBER: _ClassVar[int]
    WHAT_FIELD_NUMBER: _ClassVar[int]
    DETAIL_FIELD_NUMBER: _ClassVar[int]
    time: float
    what: str
    detail: str
    def __init__(self, time: _Optional[float] = ..., what: _Optional[str] = ..., detail: _Optional[str] = ...) -> None: ...

class Dropped(_message.Message):
    __slots__ = ("messages",)
    MESSAGES_FIELD_NUMBER: _ClassVar[int]
    messages: int
    def __init__(self, messages: _Optional[int] = ...) -> None: ...

class Recovered(_message.Message):
    __slots__ = ("lost_bytes", "ended")
    LOST_BYTES_FIELD_NUMBER: _ClassVar[int]
    ENDED_FIELD_NUMBER: _ClassVar[int]
    lost_bytes: int
    ended: bool
    def __init__(self, lost_bytes: _Optional[int] = ..., ended: _Optional[bool] = ...) -> None: ...

class End(_message.Message):
    __slots__ = ("status", "stop_reason", "duration", "wall", "begun", "recovered", "safety")
    STATUS_FIELD_NUMBER: _ClassVar[int]
    STOP_REASON_FIELD_NUMBER: _ClassVar[int]
    DURATION_FIELD_NUMBER: _ClassVar[int]
    WALL_FIELD_NUMBER: _ClassVar[int]
    BEGUN_FIELD_NUMBER: _ClassVar[int]
    RECOVERED_FIELD_NUMBER: _ClassVar[int]
    SAFETY_FIELD_NUMBER: _ClassVar[int]
    status: str
    stop_reason: str
    duration: float
    wall: float
    begun: float
    recovered: str
    safety: str
    def __init__(self, status: _Optional[str] = ..., stop_reason: _Optional[str] = ..., duration: _Optional[float] = ..., wall: _Optional[float] = ..., begun: _Optional[float] = ..., recovered: _Optional[str] = ..., safety: _Optional[str] = ...) -> None: ...
