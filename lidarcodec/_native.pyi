"""Types of the native core, by tools/native_stub.py; the docstring of each function is in native/bindings."""

from collections.abc import Callable, Sequence

import numpy
from numpy.typing import NDArray

def crc32c(data: bytes, seed: int = 0) -> int: ...
def count_activities(values: NDArray[numpy.uint16]) -> NDArray[numpy.uint32]: ...
def split_by_activity(values: NDArray[numpy.uint16], group_of: NDArray[numpy.uint8]) -> NDArray[numpy.uint16]: ...
def decode_pco_groups(data: bytes, returns: int) -> NDArray[numpy.uint16]: ...
def read_pco_chunk(data: bytes, count: int) -> tuple[NDArray[numpy.int16], int]: ...
def split_by_neighbour(bytes: NDArray[numpy.uint8], group_of: NDArray[numpy.uint8]) -> NDArray[numpy.uint8]: ...
def join_by_neighbour(
    sorted: NDArray[numpy.uint8], group_of: NDArray[numpy.uint8], counts: NDArray[numpy.uint32]
) -> NDArray[numpy.uint8]: ...

class VoxelIndex:
    def __init__(self, points: NDArray[numpy.float64], cell_m: float) -> None: ...
    def __len__(self) -> int: ...
    def near(self, queries: NDArray[numpy.float64], reach_m: float) -> NDArray[numpy.uint8]: ...
    def nearest(self, queries: NDArray[numpy.float64], reach_m: float) -> NDArray[numpy.int32]: ...

def fill_blocks(
    samples: NDArray[numpy.float32], known: NDArray[numpy.uint8], steps: NDArray[numpy.uint16], rounds: int
) -> NDArray[numpy.float32]: ...
def fill_predicted(values: NDArray[numpy.uint16], known: NDArray[numpy.uint8]) -> NDArray[numpy.uint16]: ...
def write_jpeg(samples: NDArray[numpy.float32], steps: NDArray[numpy.uint16], bits: int) -> bytes: ...
def encode_mask(
    mask: NDArray[numpy.uint8],
    fired: NDArray[numpy.uint8],
    half: NDArray[numpy.uint8],
    rotation: NDArray[numpy.int32],
    earlier: NDArray[numpy.uint8],
    turn: int,
) -> bytes: ...
def decode_mask(
    data: bytes,
    fired: NDArray[numpy.uint8],
    half: NDArray[numpy.uint8],
    rotation: NDArray[numpy.int32],
    earlier: NDArray[numpy.uint8],
) -> NDArray[numpy.uint8]: ...
def encode_keep(
    keep: NDArray[numpy.uint8],
    azimuth: NDArray[numpy.uint16],
    fired: NDArray[numpy.uint8],
    half: NDArray[numpy.uint8],
    rotation: NDArray[numpy.int32],
    earlier: NDArray[numpy.uint8],
) -> bytes: ...
def decode_keep(
    data: bytes,
    azimuth: NDArray[numpy.uint16],
    fired: NDArray[numpy.uint8],
    half: NDArray[numpy.uint8],
    rotation: NDArray[numpy.int32],
    earlier: NDArray[numpy.uint8],
) -> NDArray[numpy.uint8]: ...

class MaskStream:
    def __init__(self) -> None: ...
    def copy(self) -> MaskStream: ...
    def forget(self) -> None: ...
    def encode(
        self,
        mask: NDArray[numpy.uint8],
        azimuth: NDArray[numpy.uint16],
        fired: NDArray[numpy.uint8],
        beams: NDArray[numpy.int32],
        expected: NDArray[numpy.uint16],
        motion: NDArray[numpy.int32],
    ) -> bytes: ...
    def decode(
        self,
        data: bytes,
        azimuth: NDArray[numpy.uint16],
        fired: NDArray[numpy.uint8],
        beams: NDArray[numpy.int32],
        expected: NDArray[numpy.uint16],
        motion: NDArray[numpy.int32],
    ) -> NDArray[numpy.uint8]: ...

class RangeHistory:
    def __init__(self) -> None: ...
    def copy(self) -> RangeHistory: ...
    def forget(self) -> None: ...
    def remember(
        self,
        ranges: NDArray[numpy.uint16],
        azimuth: NDArray[numpy.uint16],
        fired: NDArray[numpy.uint8],
        rows: NDArray[numpy.int32],
    ) -> None: ...
    def expected(
        self,
        motion: NDArray[numpy.int32],
        azimuth: NDArray[numpy.uint16],
        fired: NDArray[numpy.uint8],
        rows: NDArray[numpy.int32],
    ) -> NDArray[numpy.uint16]: ...
    def find_motion(
        self,
        ranges: NDArray[numpy.uint16],
        azimuth: NDArray[numpy.uint16],
        fired: NDArray[numpy.uint8],
        rows: NDArray[numpy.int32],
        start: NDArray[numpy.int32],
        near_start: bool = False,
    ) -> tuple[NDArray[numpy.int32], bool, int, int, int, float]: ...

class IntensityMemory:
    def __init__(self, follows: bool = False) -> None: ...
    def copy(self) -> IntensityMemory: ...
    def forget_models(self) -> None: ...

def encode_intensity(
    values: NDArray[numpy.uint8],
    returns: NDArray[numpy.uint8],
    fired: NDArray[numpy.uint8],
    half: NDArray[numpy.uint8],
    rotation: NDArray[numpy.int32],
    turn: int,
    memory: IntensityMemory | None = None,
    azimuth: NDArray[numpy.uint16] | None = None,
) -> bytes: ...
def choose_levels(
    values: NDArray[numpy.uint8],
    returns: NDArray[numpy.uint8],
    fired: NDArray[numpy.uint8],
    half: NDArray[numpy.uint8],
    rotation: NDArray[numpy.int32],
    levels: int,
) -> NDArray[numpy.uint8]: ...
def decode_intensity(
    data: bytes,
    returns: NDArray[numpy.uint8],
    fired: NDArray[numpy.uint8],
    half: NDArray[numpy.uint8],
    rotation: NDArray[numpy.int32],
    memory: IntensityMemory | None = None,
    azimuth: NDArray[numpy.uint16] | None = None,
) -> NDArray[numpy.uint8]: ...
def encode_refinement(
    ranges: NDArray[numpy.uint16],
    base: NDArray[numpy.uint16],
    fired: NDArray[numpy.uint8],
    half: NDArray[numpy.uint8],
    rotation: NDArray[numpy.int32],
    level: NDArray[numpy.int32],
    base_step: int,
    fine_step: int,
    turn: int,
) -> bytes: ...
def decode_refinement(
    data: bytes,
    base: NDArray[numpy.uint16],
    fired: NDArray[numpy.uint8],
    half: NDArray[numpy.uint8],
    rotation: NDArray[numpy.int32],
    level: NDArray[numpy.int32],
    base_step: int,
    fine_step: int,
    turn: int,
) -> NDArray[numpy.uint16]: ...
def net_forms() -> list[str]: ...

class RiddleNets:
    def __init__(self) -> None: ...
    def set(
        self,
        w1: NDArray[numpy.int16],
        b1: NDArray[numpy.int32],
        s1: int,
        c1: NDArray[numpy.int8],
        w2: NDArray[numpy.int16],
        b2: NDArray[numpy.int32],
        s2: int,
        c2: NDArray[numpy.int8],
        w3: NDArray[numpy.int16],
        b3: NDArray[numpy.int32],
        s3: int,
        c3: NDArray[numpy.int8],
        form: str = "",
    ) -> None: ...
    def run(self, inputs: NDArray[numpy.int8]) -> NDArray[numpy.int16]: ...

def riddle_samples(
    ranges: NDArray[numpy.uint16],
    returns: NDArray[numpy.uint8],
    step: int,
    level: NDArray[numpy.int32],
    fired: NDArray[numpy.uint8],
    half: NDArray[numpy.uint8],
    rotation: NDArray[numpy.int32],
    turn: int,
    expected: NDArray[numpy.uint16],
    share: int,
    seed: int,
) -> tuple[NDArray[numpy.int8], NDArray[numpy.uint8], NDArray[numpy.uint8]]: ...

class RiddleSamples:
    def __init__(self, share: int, seed: int) -> None: ...
    def __len__(self) -> int: ...
    def taken(self) -> tuple[NDArray[numpy.int8], NDArray[numpy.uint8], NDArray[numpy.uint8], NDArray[numpy.int16]]: ...
    @property
    def inputs(self) -> int: ...

class RiddleTrainer:
    def __init__(
        self,
        w1: NDArray[numpy.int16],
        b1: NDArray[numpy.int32],
        s1: int,
        c1: NDArray[numpy.int8],
        w2: NDArray[numpy.int16],
        b2: NDArray[numpy.int32],
        s2: int,
        c2: NDArray[numpy.int8],
        w3: NDArray[numpy.int16],
        b3: NDArray[numpy.int32],
        s3: int,
        c3: NDArray[numpy.int8],
        rate: float,
        mean: float,
        beside: float,
        batch: int,
        room: int,
        turns: int,
        held_room: int,
        seed: int,
    ) -> None: ...
    def add(self, samples: RiddleSamples, held: bool) -> None: ...
    def train(self, steps: int, budget_ms: float) -> int: ...
    def layer(self, which: int) -> tuple[NDArray[numpy.float32], NDArray[numpy.float32]]: ...
    def conditional_bias(self) -> NDArray[numpy.float32]: ...
    def cost(self, nets: RiddleNets, beside: float) -> float: ...
    @property
    def samples(self) -> int: ...
    @property
    def held(self) -> int: ...
    @property
    def steps(self) -> int: ...

def coding_paths() -> list[str]: ...
def has_free_processor() -> bool: ...
def known_columns(data: bytes) -> int: ...

class PredictiveCoder:
    def __init__(self, path: str = "", nets: object | None = None, at_once: bool | None = None) -> None: ...
    def change(self, nets: object) -> None: ...
    def copy(self) -> PredictiveCoder: ...
    def reset(self) -> None: ...
    def encode(
        self,
        ranges: NDArray[numpy.uint16],
        returns: NDArray[numpy.uint8],
        step: int,
        level: NDArray[numpy.int32],
        fired: NDArray[numpy.uint8],
        half: NDArray[numpy.uint8],
        rotation: NDArray[numpy.int32],
        turn: int,
        firing: int,
        expected: NDArray[numpy.uint16],
        known: int,
        samples: RiddleSamples | None,
        quick: bool,
        sent: NDArray[numpy.uint16],
        halves: bool,
    ) -> bytes: ...
    def decode(
        self,
        data: bytes,
        returns: NDArray[numpy.uint8],
        step: int,
        level: NDArray[numpy.int32],
        fired: NDArray[numpy.uint8],
        half: NDArray[numpy.uint8],
        rotation: NDArray[numpy.int32],
        expected: NDArray[numpy.uint16],
        known: int,
        before: NDArray[numpy.uint16],
    ) -> NDArray[numpy.uint16]: ...

def encode_planes(
    planes: Sequence[NDArray[numpy.unsignedinteger]],
    forms: NDArray[numpy.uint8],
    shift: NDArray[numpy.int32],
    step: int,
    quick: bool,
) -> bytes: ...
def decode_planes(
    data: bytes, columns: int, forms: NDArray[numpy.uint8], shift: NDArray[numpy.int32], step: int
) -> list[NDArray[numpy.uint32]]: ...

class PlaneMemory:
    def __init__(self) -> None: ...
    def forget(self) -> None: ...
    @property
    def columns(self) -> int: ...
    def encode(
        self,
        planes: Sequence[NDArray[numpy.unsignedinteger]],
        forms: NDArray[numpy.uint8],
        shift: NDArray[numpy.int32],
        step: int,
        runs: NDArray[numpy.uint32],
        beams: NDArray[numpy.int32],
        azimuth: NDArray[numpy.uint16],
        metre: float,
    ) -> bytes: ...
    def decode(
        self, data: bytes, columns: int, forms: NDArray[numpy.uint8], shift: NDArray[numpy.int32], step: int
    ) -> list[NDArray[numpy.uint32]]: ...

def encode_numbers(values: NDArray[numpy.uint64], counts: NDArray[numpy.uint64]) -> bytes: ...
def decode_numbers(data: bytes, counts: NDArray[numpy.uint64]) -> NDArray[numpy.uint64]: ...
def best_form(values: NDArray[numpy.int64], modulus: int) -> tuple[int, int, int, NDArray[numpy.int64], int]: ...
def best_period(types: NDArray[numpy.uint8], longest: int) -> int: ...
def encode_azimuth(azimuth: NDArray[numpy.uint16], fired: NDArray[numpy.uint8]) -> bytes: ...
def decode_azimuth(data: bytes, width: int) -> tuple[NDArray[numpy.uint16], NDArray[numpy.uint8]]: ...
def columns_in_turn(rotations: NDArray[numpy.uint16]) -> int: ...

class Simulator:
    def __init__(self, scene: str, seed: int, speed: float, traffic: float, start_ns: int) -> None: ...
    def packets(self, count: int) -> NDArray[numpy.uint8]: ...
    def packets_with_truth(
        self, count: int
    ) -> tuple[NDArray[numpy.uint8], NDArray[numpy.float32], NDArray[numpy.uint8]]: ...
    def ground_height(self, places: NDArray[numpy.float64]) -> NDArray[numpy.float64]: ...
    def skip(self, count: int) -> None: ...

class SimulatorPoses:
    def __init__(self, scene: str, seed: int, speed: float, traffic: float) -> None: ...
    def at(self, t_ns: NDArray[numpy.int64]) -> NDArray[numpy.float64]: ...
    def road_users(
        self, t_ns: int, reach_m: float
    ) -> tuple[NDArray[numpy.uint8], NDArray[numpy.uint32], NDArray[numpy.float64]]: ...

class SpinningSimulator:
    def __init__(
        self, scene: str, seed: int, speed: float, traffic: float, traits: dict[str, float], rows: int
    ) -> None: ...
    def fire(
        self, t_ns: NDArray[numpy.int64], beams: NDArray[numpy.float64], far_m: float
    ) -> tuple[
        NDArray[numpy.uint32],
        NDArray[numpy.uint16],
        NDArray[numpy.uint16],
        NDArray[numpy.uint16],
        NDArray[numpy.uint32],
        NDArray[numpy.uint16],
        NDArray[numpy.uint16],
        NDArray[numpy.float32],
        NDArray[numpy.uint8],
    ]: ...

def simulator_calibration() -> NDArray[numpy.int32]: ...

SIMULATOR_PACKET_NS: int = 288006

def assemble(
    payloads: bytes, ring_of_laser: NDArray[numpy.uint8]
) -> tuple[
    NDArray[numpy.uint16],
    NDArray[numpy.uint8],
    NDArray[numpy.uint16],
    NDArray[numpy.uint8],
    NDArray[numpy.uint8],
    NDArray[numpy.uint16],
    NDArray[numpy.uint8],
    NDArray[numpy.uint8],
    NDArray[numpy.uint32],
    NDArray[numpy.uint8],
]: ...
def disassemble(
    range: NDArray[numpy.uint16],
    intensity: NDArray[numpy.uint8],
    azimuth: NDArray[numpy.uint16],
    fired: NDArray[numpy.uint8],
    layouts: NDArray[numpy.uint8],
    layout: NDArray[numpy.uint16],
    irregular: NDArray[numpy.uint8],
    second: NDArray[numpy.uint8],
    gps_us: NDArray[numpy.uint32],
    status: NDArray[numpy.uint8],
    ring_of_laser: NDArray[numpy.uint8],
) -> bytes: ...
def points_of_returns(
    range: NDArray[numpy.uint32],
    keep: NDArray[numpy.uint8] | None,
    intensity: NDArray[numpy.uint8],
    cosine: NDArray[numpy.float64],
    sine: NDArray[numpy.float64],
    t_ns: NDArray[numpy.int64],
    factors: NDArray[numpy.float64],
    laser_of_ring: NDArray[numpy.uint8],
    range_step: float,
    turned: bool,
    two_point: bool,
) -> NDArray[numpy.uint8]: ...

class SenderJudge:
    def __init__(
        self,
        pinned: bytes = ...,
        all: bool = False,
        shapes: Sequence[tuple[int, int, int, bool, Sequence[int], bool]] = [],
        hdl64e: bool = True,
    ) -> None: ...
    def judge(self, payload: bytes, address: bytes, port: int, now_ns: int) -> int: ...
    def settle(self, now_ns: int) -> bool: ...
    @property
    def chosen(self) -> int: ...
    @property
    def reason(self) -> int: ...
    @property
    def changes(self) -> int: ...
    @property
    def refused(self) -> int: ...
    @property
    def not_pinned(self) -> int: ...
    @property
    def last_not_pinned(self) -> tuple[bytes, int]: ...
    def report(self) -> list[tuple[int, tuple[bytes, int], int, int, int]]: ...

class UdpReceiver:
    def __init__(
        self,
        fd: int,
        capacity: int,
        pinned: bytes = ...,
        all: bool = False,
        shapes: Sequence[tuple[int, int, int, bool, Sequence[int], bool]] = [],
        any_size: bool = False,
        hdl64e: bool = True,
    ) -> None: ...
    def take(
        self, most: int, limit_s: float
    ) -> tuple[bytes, NDArray[numpy.uint32], NDArray[numpy.int64], NDArray[numpy.uint32]]: ...
    def senders(self) -> SenderJudge: ...
    def holding(self) -> bool: ...
    def counts(self) -> tuple[int, int, int, int]: ...
    def failure(self) -> int: ...
    def stop(self) -> None: ...

class Session:
    def __init__(
        self,
        unzstd: Callable[[bytes, int], bytes],
        inflate: Callable[[bytes, int], bytes | None],
        weights: Callable[[str], bytes | None],
        reads_ranges: bool,
        takes_model: Callable[[str], bool] | None = None,
    ) -> None: ...
    def decode(
        self, message: object
    ) -> tuple[
        NDArray[numpy.uint16],
        NDArray[numpy.uint8],
        NDArray[numpy.uint16],
        NDArray[numpy.uint8],
        NDArray[numpy.uint8],
        NDArray[numpy.float64] | None,
        tuple[str, int, int, bytes],
    ]: ...
    def decode_images(
        self, message: object
    ) -> tuple[
        tuple[str, int, int, int, str, bytes, bytes],
        list[tuple[str, NDArray[numpy.unsignedinteger]]],
        tuple[
            str,
            NDArray[numpy.int64],
            NDArray[numpy.uint16],
            list[bytes],
            list[tuple[str, NDArray[numpy.unsignedinteger]]],
        ],
        NDArray[numpy.uint16],
        NDArray[numpy.uint16] | None,
        NDArray[numpy.float64] | None,
    ]: ...
    def cut(self) -> None: ...

def knows_model(model: str) -> bool: ...
def decode_plane_section(
    data: bytes, columns: int, unzstd: Callable[[bytes, int], bytes]
) -> list[tuple[str, NDArray[numpy.unsignedinteger]]]: ...
def decode_rest(
    data: bytes, packets: int, unzstd: Callable[[bytes, int], bytes]
) -> tuple[
    str, NDArray[numpy.int64], NDArray[numpy.uint16], list[bytes], list[tuple[str, NDArray[numpy.unsignedinteger]]]
]: ...
def encode_points(
    xyz: NDArray[numpy.float32],
    returned: NDArray[numpy.uint8],
    cells: tuple[int, int, NDArray[numpy.int64], NDArray[numpy.int64]],
    geometry: tuple[float, int, bool, int, NDArray[numpy.float64], int, float],
    n: NDArray[numpy.uint32] | None,
    k: NDArray[numpy.int32] | None,
    none: NDArray[numpy.uint32] | None,
    bound_m: float,
    by_column: bool,
) -> tuple[bytes, NDArray[numpy.uint8], NDArray[numpy.uint32], NDArray[numpy.int32], float, bool]: ...
def decode_points(
    data: bytes,
    cells: tuple[int, int, NDArray[numpy.int64], NDArray[numpy.int64]],
    geometry: tuple[float, int, bool, int, NDArray[numpy.float64], int, float],
    n: NDArray[numpy.uint32],
) -> tuple[NDArray[numpy.float32], NDArray[numpy.int32]]: ...
def encode_field_rests(
    cells: tuple[int, int, NDArray[numpy.int64], NDArray[numpy.int64]], rests: NDArray[numpy.uint32]
) -> bytes: ...
def decode_field_rests(
    data: bytes, cells: tuple[int, int, NDArray[numpy.int64], NDArray[numpy.int64]]
) -> NDArray[numpy.uint32]: ...
def encode_sums(
    cells: tuple[int, int, NDArray[numpy.int64], NDArray[numpy.int64]],
    numbers: NDArray[numpy.int64],
    by_row: NDArray[numpy.int64],
) -> tuple[NDArray[numpy.int64], bytes, int] | None: ...
def encode_times(
    cells: tuple[int, int, NDArray[numpy.int64], NDArray[numpy.int64]],
    times: NDArray[numpy.float32],
    by_row: NDArray[numpy.int64],
) -> tuple[NDArray[numpy.int64], bytes, int] | None: ...
def decode_sums(
    left: bytes,
    cells: tuple[int, int, NDArray[numpy.int64], NDArray[numpy.int64]],
    by_column: NDArray[numpy.int64],
    by_row: NDArray[numpy.int64],
) -> NDArray[numpy.int64]: ...
def decode_times(
    left: bytes,
    cells: tuple[int, int, NDArray[numpy.int64], NDArray[numpy.int64]],
    by_column: NDArray[numpy.int64],
    by_row: NDArray[numpy.int64],
) -> NDArray[numpy.float32]: ...
def message_of_points(
    head: bytes, tail: bytes, points: int, step: int, big_endian: bool, fields: list[tuple[int, object]]
) -> bytes: ...
def points_of_images(
    order: tuple[int, int, bool, NDArray[numpy.int64]], full: bool, images: list[object]
) -> tuple[NDArray[numpy.int64], NDArray[numpy.int64], list[NDArray[numpy.uint32]]]: ...
def columns_of_firing(
    rank: NDArray[numpy.int64],
    turned: NDArray[numpy.float64],
    jump: float,
    ring: NDArray[numpy.int64],
    x: NDArray[numpy.float32],
    y: NDArray[numpy.float32],
    returned: NDArray[numpy.uint8],
) -> NDArray[numpy.int64]: ...
def returns_of(
    ranges: NDArray[numpy.uint16],
    azimuth: NDArray[numpy.uint16],
    fired: NDArray[numpy.uint8],
    rows: NDArray[numpy.int32],
) -> tuple[NDArray[numpy.int32], NDArray[numpy.uint32]]: ...
def lattice_of(
    cells: NDArray[numpy.uint32],
    azimuth: NDArray[numpy.uint16],
    fired: NDArray[numpy.uint8],
    rows: NDArray[numpy.int32],
) -> tuple[NDArray[numpy.uint32], NDArray[numpy.uint8]]: ...
def pick_cells(
    xyz: NDArray[numpy.int32], order: NDArray[numpy.uint32], want: int, side: int
) -> tuple[NDArray[numpy.uint32], int]: ...
def deskewed(
    xyz: NDArray[numpy.int32], cells: NDArray[numpy.uint32], moved: NDArray[numpy.float32]
) -> NDArray[numpy.float32]: ...
def ground_of(
    xyz: NDArray[numpy.float32],
    cells: NDArray[numpy.uint32],
    azimuth: NDArray[numpy.uint16],
    fired: NDArray[numpy.uint8],
    rows: NDArray[numpy.int32],
) -> NDArray[numpy.uint8]: ...
def unseen(
    xyz: NDArray[numpy.float32],
    ground: NDArray[numpy.uint8],
    past: Sequence[tuple[NDArray[numpy.float32], NDArray[numpy.float32]]],
) -> NDArray[numpy.uint8]: ...
def encode_tile(
    points: NDArray[numpy.uint32],
    values: NDArray[numpy.uint16],
    levels: int,
    cell: int,
    reach: int,
    bits: Sequence[int],
) -> bytes: ...
def decode_tile(
    data: bytes, count: int, levels: int, cell: int, reach: int, bits: Sequence[int]
) -> tuple[NDArray[numpy.uint32], NDArray[numpy.uint16]]: ...
def ground_points(points: NDArray[numpy.float32]) -> NDArray[numpy.uint8]: ...
def cluster_points(
    points: NDArray[numpy.float32], rows: NDArray[numpy.uint16], ground: NDArray[numpy.uint8]
) -> NDArray[numpy.int32]: ...
