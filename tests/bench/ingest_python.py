"""The work of `reel ingest` in Python: MCAP traces into Parquet with PyPI mcap, protobuf and pyarrow.

The yardstick that ingest is measured against, tuned as its users would tune it: every file is read once, every
checksum is verified, images and viewers' channels are skipped undecoded, messages are decoded by upb with the
schemas of the file, the hash chain and the digests of task and scene are computed anew, columns are made of flat
tuples, and rows leave in batches. mcap's own reader would take most of the time then: by default this script goes
through the records itself and leaves it the parsing of chunk headers, attachments, schemas and channels. The rows are
those of `episodes`, `tasks`, `scenes` and `quarantine` (`schemas/tables.md`); `check_ingest.py` compares them with ours.

With `--no-chain` it takes the digests of the hash chain, the task and the scene as they stand. It knows neither
incremental ingest nor two traces of one episode, and does not refuse everything that the chain does not cover: repeated
messages, another order, unknown fields, a class that is not that of its error.

  ingest_python.py TRACES... --out DIR [--processes 2] [--reader library] [--no-chain]

Needs PyPI mcap, protobuf, zstandard, orjson, blake3 and pyarrow.
"""

import argparse
import contextlib
import functools
import gc
import json
import multiprocessing
import os
import resource
import struct
import time
import zlib
from io import BytesIO
from pathlib import Path

import pyarrow as pa
import pyarrow.parquet as pq
import zstandard
from google.protobuf.descriptor_pb2 import FileDescriptorSet
from google.protobuf.descriptor_pool import DescriptorPool
from google.protobuf.message_factory import GetMessageClass
from mcap.data_stream import ReadDataStream
from mcap.opcode import Opcode
from mcap.records import Attachment, Channel, Chunk, ChunkIndex, Message, Metadata, Schema
from mcap.stream_reader import StreamReader, breakup_chunk

from ingest_chain import Chain, check_attachments
from ingest_rows import Rows, Task, documented_schemas

# Episodes in a batch, which becomes a row group.
BATCH = 1024
# Parsed tasks that are kept.
TASKS_KEPT = 1024

MAGIC = b"\x89MCAP0\r\n"
FOOTER_BYTES = 9 + 20
# Opcode, length and, of a message, its channel.
HEAD = struct.Struct("<BQH").unpack_from
CRC = struct.Struct("<I").unpack_from
RECORD_PREFIX = 9
MESSAGE_PREFIX = 2 + 4 + 8 + 8


def main():
    parser = argparse.ArgumentParser(description=__doc__.split("\n")[0])
    parser.add_argument("traces", nargs="+", type=Path, help="trace files, or folders of them")
    parser.add_argument("--out", required=True, type=Path, help="folder for the Parquet files; should be empty")
    parser.add_argument("--processes", type=int, default=1)
    parser.add_argument("--reader", choices=READERS, default="fast", help="who goes through the records")
    parser.add_argument("--no-chain", action="store_true", help="take the digests as they stand")
    options = parser.parse_args()
    options.out.mkdir(parents=True, exist_ok=True)
    wall, cpu = time.perf_counter(), cpu_seconds()

    paths = sorted({os.path.abspath(path) for given in options.traces for path in files_of(given)})
    how = (options.out, options.reader, not options.no_chain)
    shards = [(paths[index :: options.processes], index, *how) for index in range(options.processes)]
    if options.processes == 1:
        done = [ingest(*shards[0])]
    else:
        with multiprocessing.get_context("fork").Pool(options.processes) as pool:
            done = pool.starmap(ingest, shards, chunksize=1)
            pool.close()
            pool.join()
        for table in ("tasks", "scenes"):
            merge(options.out, table, options.processes)

    peaks = [resource.getrusage(resource.RUSAGE_SELF).ru_maxrss] + [peak for _, _, peak in done] * (options.processes > 1)
    report = {
        "episodes": sum(episodes for episodes, _, _ in done),
        "quarantined": sum(bad for _, bad, _ in done),
        "cpu_s": round(cpu_seconds() - cpu, 3),
        "wall_s": round(time.perf_counter() - wall, 3),
        "peak_rss_bytes": 1024 * sum(peaks),
    }
    print(json.dumps(report))


def files_of(given):
    return given.rglob("*.mcap") if given.is_dir() else [given]


def cpu_seconds():
    used = [resource.getrusage(who) for who in (resource.RUSAGE_SELF, resource.RUSAGE_CHILDREN)]
    return sum(usage.ru_utime + usage.ru_stime for usage in used)


def ingest(paths, index, out, reader, check_chain):
    """Writes the rows of some files; gives how many episodes and bad files there were, and the peak of memory in KiB."""
    gc.disable()  # nothing here is cyclic
    schemas = documented_schemas()
    counts = dict.fromkeys(schemas, 0)
    reader, rows = READERS[reader](check_chain), Rows()
    with contextlib.ExitStack() as stack:
        writers = {}
        for table, schema in schemas.items():
            writer = pq.ParquetWriter(out / f"{table}-{index}.parquet", schema, compression="zstd", compression_level=1)
            writers[table] = stack.enter_context(writer)

        def flush():
            for table, batch in rows.take(schemas).items():
                counts[table] += batch.num_rows
                if batch.num_rows:
                    writers[table].write_batch(batch)

        for path in paths:
            try:
                trace = reader.read(path)
            except Exception as error:  # whatever is wrong with a file, the others go on
                rows.quarantine.append((path, f"{type(error).__name__}: {error}"))
                continue
            rows.add(trace)
            if len(rows.episodes) == BATCH:
                flush()
        flush()
    return counts["episodes"], counts["quarantine"], resource.getrusage(resource.RUSAGE_SELF).ru_maxrss


def merge(out, table, processes):
    """Leaves one row a key of what several processes wrote."""
    paths = [out / f"{table}-{index}.parquet" for index in range(processes)]
    rows = pa.concat_tables(pq.read_table(path) for path in paths)
    keys = rows[f"{table[:-1]}_digest"]
    rows = rows.take([keys.index(key).as_py() for key in keys.unique()])
    for path in paths:
        path.unlink()
    pq.write_table(rows, paths[0], compression="zstd")


# Reading a trace.


class Trace:
    """The decoded messages of a file."""

    def __init__(self, path, size, modified_ns, check_chain):
        self.path, self.bytes, self.modified_ns = path, size, modified_ns
        self.start = self.settled = self.end = None
        # one of each kind a step; of the moments and graphs first one of the start
        self.calls, self.results, self.diffs, self.rewards, self.moments, self.offsets = [], [], [], [], [], []
        self.graphs = []
        self.chain, self.build = Chain(check_chain), ""
        # where a step has them
        self.policies, self.latencies, self.logprobs, self.outside, self.answers = {}, {}, {}, {}, {}

    def metadata(self, record):
        """The version of Reel stands nowhere else."""
        if record.name == "reel.episode":
            self.build = record.metadata["build"]


class Reader:
    """Reads traces; keeps what many of them share."""

    def __init__(self, check_chain):
        self.check_chain = check_chain
        self.records, self.decoders = {}, {}
        self.task_of = functools.lru_cache(TASKS_KEPT)(Task)
        self.decompress = zstandard.ZstdDecompressor().decompress

    def read(self, path):
        with open(path, "rb") as file:
            data = file.read()
            trace = Trace(path, len(data), os.fstat(file.fileno()).st_mtime_ns, self.check_chain)
        attachments = self.walk(data, trace)
        steps = range(len(trace.calls))
        kinds = (trace.calls, trace.results, trace.diffs, trace.rewards, trace.moments[1:])
        linked = len(trace.chain.links) == len(steps) + 2
        if not trace.end or not linked or trace.end.steps != len(steps) or any([m.step for m in kind] != [*steps] for kind in kinds):
            raise ValueError("the end of the episode or a message of a step is missing")
        if self.check_chain:
            check_attachments(trace.start, attachments["task.json"], attachments["scene.json"])
        trace.task = self.task_of(attachments["task.json"], trace.start.task_digest)
        trace.scene = attachments["scene.json"]
        return trace

    def walk(self, data, trace):
        """Goes through the records of the data section; gives the attachments by name."""
        if not (data.startswith(MAGIC) and data.endswith(MAGIC)):
            raise ValueError("it is no finished MCAP file")
        attachments, schemas, takers = {}, {}, {}
        at, view, stream = len(MAGIC), memoryview(data), BytesIO(data)
        while True:
            opcode, length, _ = HEAD(data, at)
            body, after = at + RECORD_PREFIX, at + RECORD_PREFIX + length
            if opcode == Opcode.CHUNK:
                stream.seek(body)
                self.chunk(Chunk.read(ReadDataStream(stream)), at, trace, schemas, takers)
            elif opcode == Opcode.ATTACHMENT:
                stream.seek(body)
                attachment = Attachment.read(ReadDataStream(stream))
                attachments[attachment.name] = attachment.data
            elif opcode == Opcode.METADATA:
                stream.seek(body)
                trace.metadata(Metadata.read(ReadDataStream(stream)))
            elif opcode == Opcode.DATA_END:
                break
            at = after
        summary_end = len(data) - len(MAGIC) - 4
        if CRC(data, body)[0] != zlib.crc32(view[:at]) or CRC(data, summary_end)[0] != zlib.crc32(view[after:summary_end]):
            raise ValueError("a checksum is wrong")
        return attachments

    def chunk(self, chunk, offset, trace, schemas, takers):
        data = self.decompress(chunk.data, max_output_size=chunk.uncompressed_size) if chunk.compression else chunk.data
        if zlib.crc32(data) != chunk.uncompressed_crc:
            raise ValueError("the checksum of a chunk is wrong")
        at, end = 0, len(data)
        while at < end:
            opcode, length, channel = HEAD(data, at)
            body = at + RECORD_PREFIX
            at = body + length
            if opcode == Opcode.MESSAGE:
                take = takers[channel]
                if take:
                    take(data[body + MESSAGE_PREFIX : at], offset)
            elif opcode == Opcode.SCHEMA:
                schema = self.record(Schema, data[body:at])
                schemas[schema.id] = schema
            elif opcode == Opcode.CHANNEL:
                known = self.record(Channel, data[body:at])
                takers[known.id] = self.taker(known, schemas, trace)

    def record(self, kind, body):
        """A parsed record; all files have the same few schemas and channels."""
        record = self.records.get(body)
        if not record:
            record = self.records[body] = kind.read(ReadDataStream(BytesIO(body)))
        return record

    def taker(self, channel, schemas, trace):
        """What takes the messages of a channel; none where nobody needs them."""
        make = TAKERS.get(channel.topic)
        return make and trace.chain.covering(channel.topic, make(self.decoder(schemas[channel.schema_id]), trace))

    def decoder(self, schema):
        decode = self.decoders.get((schema.name, schema.data))
        if not decode:
            pool = DescriptorPool()
            for file in FileDescriptorSet.FromString(schema.data).file:
                pool.Add(file)
            decode = GetMessageClass(pool.FindMessageTypeByName(schema.name)).FromString
            self.decoders[schema.name, schema.data] = decode
        return decode


class LibraryReader(Reader):
    """Leaves all records to the reader of mcap, as most of its users would."""

    def walk(self, data, trace):
        attachments, schemas, takers, chunks, starts = {}, {}, {}, 0, []
        for record in StreamReader(BytesIO(data), emit_chunks=True, validate_crcs=True).records:
            if isinstance(record, Chunk):
                for inner in breakup_chunk(record, validate_crc=True):
                    if isinstance(inner, Message):
                        take = takers[inner.channel_id]
                        if take:
                            take(inner.data, chunks)
                    elif isinstance(inner, Schema):
                        schemas[inner.id] = inner
                    else:
                        takers[inner.id] = self.taker(inner, schemas, trace)
                chunks += 1
            elif isinstance(record, Attachment):
                attachments[record.name] = record.data
            elif isinstance(record, Metadata):
                trace.metadata(record)
            elif isinstance(record, ChunkIndex):
                starts.append(record.chunk_start_offset)
        trace.offsets = [starts[chunk] for chunk in trace.offsets]
        return attachments


READERS = {"fast": Reader, "library": LibraryReader}


def appending(name):
    def make(decode, trace):
        append = getattr(trace, name).append
        return lambda data, offset: append(decode(data))

    return make


def taking_calls(decode, trace):
    def take(data, offset):
        trace.calls.append(decode(data))
        trace.offsets.append(offset)

    return take


def taking_events(decode, trace):
    def take(data, offset):
        event = decode(data)
        name = event.WhichOneof("event")
        setattr(trace, name, getattr(event, name))

    return take


def by_step(kind):
    def make(decode, trace):
        known = getattr(trace, kind)

        def take(data, offset):
            message = decode(data)
            known[message.step] = message

        return take

    return make


def taking_replies(decode, trace):
    replies = {"outside": trace.outside, "answer": trace.answers}

    def take(data, offset):
        reply = decode(data)
        replies[reply.kind][reply.step] = reply

    return take


def taking_links(decode, trace):
    return lambda data, offset: trace.chain.link(decode(data).link)


# By topic: what takes the messages of a trace. Nobody needs the others.
TAKERS = {
    "/episode": taking_events,
    "/world/graph": appending("graphs"),
    "/tool/call": taking_calls,
    "/policy/output": by_step("policies"),
    "/logprobs": by_step("logprobs"),
    "/user/dialogue": taking_replies,
    "/tool/result": appending("results"),
    "/world/diff": appending("diffs"),
    "/reward": appending("rewards"),
    "/sim/digest": appending("moments"),
    "/chain": taking_links,
    "/policy/latency": by_step("latencies"),
}


if __name__ == "__main__":
    main()
