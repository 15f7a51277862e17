"""Reads an exported folder with TensorBoard's own reader, or prints the golden bytes of `src/export/tensorboard.rs`.

read.py FOLDER     every stage's tags and how many steps they have; fails where there are none
read.py golden
"""
import io
import sys
from pathlib import Path

from tensorboard.backend.event_processing.event_accumulator import EventAccumulator
from tensorboard.compat.proto import event_pb2, summary_pb2
from tensorboard.summary.writer.record_writer import RecordWriter


def golden():
    out = io.BytesIO()
    writer = RecordWriter(out)
    value = summary_pb2.Summary.Value(tag="loss", simple_value=0.5)
    events = [
        event_pb2.Event(file_version="brain.Event:2"),
        event_pb2.Event(wall_time=300, step=300, summary=summary_pb2.Summary(value=[value])),
    ]
    for event in events:
        writer.write(event.SerializeToString())
    return out.getvalue().hex()


def read(folder):
    files = sorted(folder.rglob("*tfevents*"))
    assert files, f"{folder} has no event files"
    for file in files:
        events = EventAccumulator(str(file.parent))
        events.Reload()
        tags = events.Tags()["scalars"]
        assert tags, f"{file} has no scalars"
        for tag in tags:
            steps = [event.step for event in events.Scalars(tag)]
            assert steps == sorted(set(steps)), f"{file}: {tag} has the steps {steps}"
        print(file.parent.relative_to(folder), {tag: len(events.Scalars(tag)) for tag in tags})


if __name__ == "__main__":
    print(golden()) if sys.argv[1] == "golden" else read(Path(sys.argv[1]))
