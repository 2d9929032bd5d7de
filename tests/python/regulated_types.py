"""The regulated Cyphal types that pycyphal's application layer and the node use, as DSDL. Importing this module compiles
them: the package `uavcan` can be imported afterwards.

Names, fields and sizes are those of OpenCyphal's public_regulated_data_types, which no package index carries;
the text is written down here without the comments of the original. `slipsense-recording` compares the node's bytes
with the crate canadensis_data_types, which is generated from the original.
"""

import pathlib
import sys
import tempfile

import pycyphal.dsdl

KINDS = (("int", "Integer", (64, 32, 16, 8)), ("uint", "Natural", (64, 32, 16, 8)), ("float", "Real", (64, 32, 16)))
# Type of an element and most elements, by name.
ARRAYS = {"Bit": ("bool", 2048)} | {
    f"{name}{bits}": (f"{kind}{bits}", 2048 // bits) for kind, name, widths in KINDS for bits in widths
}
TYPES = {
    "primitive/Empty.1.0": "@sealed",
    "primitive/String.1.0": "uint8[<=256] value\n@sealed",
    "primitive/Unstructured.1.0": "uint8[<=256] value\n@sealed",
    "time/SynchronizedTimestamp.1.0": "uint56 UNKNOWN = 0\ntruncated uint56 microsecond\n@sealed",
    "time/7168.Synchronization.1.0": "truncated uint56 previous_transmission_timestamp_microsecond\n@sealed",
    "node/Version.1.0": "uint8 major\nuint8 minor\n@sealed",
    "node/ID.1.0": "uint16 value\n@sealed",
    "node/Health.1.0": "uint2 value\nuint2 NOMINAL = 0\nuint2 ADVISORY = 1\nuint2 CAUTION = 2\nuint2 WARNING = 3\n@sealed",
    "node/Mode.1.0": "uint3 value\nuint3 OPERATIONAL = 0\nuint3 INITIALIZATION = 1\nuint3 MAINTENANCE = 2\n"
    "uint3 SOFTWARE_UPDATE = 3\n@sealed",
    "node/7509.Heartbeat.1.0": "uint16 MAX_PUBLICATION_PERIOD = 1\nuint16 OFFLINE_TIMEOUT = 3\nuint32 uptime\n"
    "Health.1.0 health\nMode.1.0 mode\nuint8 vendor_specific_status_code\n@extent 12 * 8",
    "node/430.GetInfo.1.0": "@sealed\n---\nVersion.1.0 protocol_version\nVersion.1.0 hardware_version\n"
    "Version.1.0 software_version\nuint64 software_vcs_revision_id\nuint8[16] unique_id\nuint8[<=50] name\n"
    "uint64[<=1] software_image_crc\nuint8[<=222] certificate_of_authenticity\n@extent 448 * 8",
    "node/435.ExecuteCommand.1.3": "uint16 command\nuint8[<=255] parameter\n@extent 300 * 8\n---\nuint8 status\n"
    "uint8[<=46] output\n@extent 48 * 8",
    "node/port/SubjectID.1.0": "uint13 MAX = 8191\nuint13 value\n@sealed",
    "node/port/ServiceID.1.0": "uint9 MAX = 511\nuint9 value\n@sealed",
    "node/port/SubjectIDList.1.0": "@union\nuint16 CAPACITY = SubjectID.1.0.MAX + 1\nbool[CAPACITY] mask\n"
    "SubjectID.1.0[<256] sparse_list\nuavcan.primitive.Empty.1.0 total\n@sealed",
    "node/port/ServiceIDList.1.0": "uint16 CAPACITY = ServiceID.1.0.MAX + 1\nbool[CAPACITY] mask\n@sealed",
    "node/port/7510.List.1.0": "uint8 MAX_PUBLICATION_PERIOD = 10\nSubjectIDList.1.0 publishers\n"
    "SubjectIDList.1.0 subscribers\nServiceIDList.1.0 clients\nServiceIDList.1.0 servers\n@sealed",
    "diagnostic/Severity.1.0": "uint3 value\nuint3 TRACE = 0\nuint3 DEBUG = 1\nuint3 INFO = 2\nuint3 NOTICE = 3\n"
    "uint3 WARNING = 4\nuint3 ERROR = 5\nuint3 CRITICAL = 6\nuint3 ALERT = 7\n@sealed",
    "diagnostic/8184.Record.1.1": "uavcan.time.SynchronizedTimestamp.1.0 timestamp\nSeverity.1.0 severity\n"
    "uint8[<=255] text\n@extent 300 * 8",
    "register/Name.1.0": "uint8[<=255] name\n@sealed",
    "register/Value.1.0": "@union\nuavcan.primitive.Empty.1.0 empty\nuavcan.primitive.String.1.0 string\n"
    "uavcan.primitive.Unstructured.1.0 unstructured\n"
    + "".join(f"uavcan.primitive.array.{name}.1.0 {name.lower()}\n" for name in ARRAYS)
    + "@sealed",
    "register/384.Access.1.0": "Name.1.0 name\nValue.1.0 value\n@sealed\n---\n"
    "uavcan.time.SynchronizedTimestamp.1.0 timestamp\nbool mutable\nbool persistent\nvoid6\nValue.1.0 value\n@sealed",
    "register/385.List.1.0": "uint16 index\n@sealed\n---\nName.1.0 name\n@sealed",
    "pnp/8166.NodeIDAllocationData.1.0": "truncated uint48 unique_id_hash\nuavcan.node.ID.1.0[<=1] allocated_node_id\n@sealed",
    "pnp/8165.NodeIDAllocationData.2.0": "uavcan.node.ID.1.0 node_id\nuint8[16] unique_id\n@extent 48 * 8",
    "file/Path.2.0": "uint8 SEPARATOR = '/'\nuint8 MAX_LENGTH = 255\nuint8[<=MAX_LENGTH] path\n@sealed",
    "file/Error.1.0": "uint16 value\nuint16 OK = 0\nuint16 UNKNOWN_ERROR = 65535\nuint16 NOT_FOUND = 2\nuint16 IO_ERROR = 5\n"
    "uint16 ACCESS_DENIED = 13\nuint16 IS_DIRECTORY = 21\nuint16 INVALID_VALUE = 22\nuint16 FILE_TOO_LARGE = 27\n"
    "uint16 OUT_OF_SPACE = 28\nuint16 NOT_SUPPORTED = 38\n@sealed",
    "file/405.GetInfo.0.2": "Path.2.0 path\n@extent 300 * 8\n---\nError.1.0 error\ntruncated uint40 size\n"
    "truncated uint40 unix_timestamp_of_last_modification\nbool is_file_not_directory\nbool is_link\nbool is_readable\n"
    "bool is_writeable\nvoid4\n@extent 48 * 8",
    "file/406.List.0.2": "uint32 entry_index\nvoid32\nPath.2.0 directory_path\n@extent 300 * 8\n---\nvoid32\n"
    "Path.2.0 entry_base_name\n@extent 300 * 8",
    "file/407.Modify.1.1": "bool preserve_source\nbool overwrite_destination\nvoid30\nPath.2.0 source\n"
    "Path.2.0 destination\n@extent 600 * 8\n---\nError.1.0 error\n@extent 48 * 8",
    "file/408.Read.1.1": "truncated uint40 offset\nPath.2.0 path\n@extent 300 * 8\n---\nError.1.0 error\n"
    "uavcan.primitive.Unstructured.1.0 data\n@extent 300 * 8",
    "file/409.Write.1.1": "truncated uint40 offset\nPath.2.0 path\nuavcan.primitive.Unstructured.1.0 data\n"
    "@extent 600 * 8\n---\nError.1.0 error\n@extent 48 * 8",
}
for name, (dsdl, most) in ARRAYS.items():
    TYPES[f"primitive/array/{name}.1.0"] = f"{dsdl}[<={most}] value\n@sealed"
    TYPES[f"primitive/scalar/{name}.1.0"] = f"{dsdl} value\n@sealed"

# It lasts as long as this program.
FOLDER = tempfile.TemporaryDirectory()
SOURCES, COMPILED = pathlib.Path(FOLDER.name, "dsdl/uavcan"), pathlib.Path(FOLDER.name, "python")
for name, text in TYPES.items():
    path = SOURCES / f"{name}.dsdl"
    path.parent.mkdir(parents=True, exist_ok=True)
    path.write_text(text + "\n", encoding="ascii")
pycyphal.dsdl.compile_all([SOURCES], COMPILED)
sys.path.insert(0, str(COMPILED))
