"""Reads depth and masks as others do, and compares: check.py TRACE FRAMES COCO.

TRACE was recorded with --record depth,masks; FRAMES are the same frames that `reel trace frames --layers depth,masks` drew again from a
trace without them; COCO is what `reel export coco` made of it. MCAP is read by `mcap`, masks by `pycocotools`, images by Pillow.
"""
import json
import sys
from pathlib import Path

import numpy as np
from mcap_protobuf.reader import read_protobuf_messages
from PIL import Image
from pycocotools import mask as masks
from pycocotools.coco import COCO

TOPICS = {"/camera/head/depth": "depth", "/camera/head/instances": "masks"}


def main(trace, frames, folder):
    recorded = {name: [] for name in TOPICS.values()}
    for message in read_protobuf_messages(trace, topics=list(TOPICS)):
        image = message.proto_msg
        assert (image.encoding, image.step) == ("16UC1", 2 * image.width), image.encoding
        pixels = np.frombuffer(image.data, dtype="<u2").reshape(image.height, image.width)
        recorded[TOPICS[message.topic]].append(pixels)
    drawn = {name: [np.array(Image.open(path)) for path in sorted(frames.glob(f"*.{name}.png"), key=order)] for name in recorded}
    for name, images in recorded.items():
        assert len(images) == len(drawn[name]) > 3, (name, len(images), len(drawn[name]))
        assert all(np.array_equal(a, b) for a, b in zip(images, drawn[name])), f"{name} differ"
    names = {instance["id"]: instance for instance in json.loads((frames / "instances.json").read_text())}
    shown = set(np.unique(np.stack(recorded["masks"])).tolist()) - {0}
    assert shown <= set(names), shown - set(names)
    assert {"object", "receptacle", "shell"} <= {names[id]["kind"] for id in shown}
    counted = check_coco(folder)
    print(f"{len(recorded['depth'])} frames as recorded, {counted} masks as COCO has them")


def order(path):
    return path.name if path.name.startswith("call") else ""


def check_coco(folder):
    coco = COCO(folder / "instances.json")
    panoptic = json.loads((folder / "panoptic.json").read_text())
    segments = {one["image_id"]: one for one in panoptic["annotations"]}
    assert segments.keys() == set(coco.getImgIds())
    names = {one["id"]: one["name"] for one in panoptic["categories"]}
    for image in coco.loadImgs(coco.getImgIds()):
        assert Image.open(folder / "images" / image["file_name"]).size == (image["width"], image["height"])
        assert image["trace_digest"] and image["episode_id"]
        one = segments[image["id"]]
        rgb = np.array(Image.open(folder / "panoptic" / one["file_name"])).astype(int)
        ids = rgb[..., 0] + 256 * rgb[..., 1] + 65536 * rgb[..., 2]
        assert set(np.unique(ids).tolist()) - {0} == {segment["id"] for segment in one["segments_info"]}
        found = []
        for annotation in coco.loadAnns(coco.getAnnIds(imgIds=image["id"])):
            decoded = coco.annToMask(annotation).astype(bool)
            value = np.unique(ids[decoded])
            assert len(value) == 1 and np.array_equal(decoded, ids == value[0]), annotation["instance"]
            assert annotation["area"] == decoded.sum()
            assert list(masks.toBbox(annotation["segmentation"])) == annotation["bbox"]
            assert annotation["visible_share"] is None or 0 < annotation["visible_share"] <= 1
            found.append((value[0], annotation["category_id"]))
        things = [(segment["id"], segment["category_id"]) for segment in one["segments_info"] if names[segment["category_id"]] != "shell"]
        assert sorted(found) == sorted(things)
    shares = [one["visible_share"] or 1 for one in coco.loadAnns(coco.getAnnIds())]
    assert min(shares) < 0.9 < max(shares), "some are hidden in part, others are not"
    return len(shares)


if __name__ == "__main__":
    main(*map(Path, sys.argv[1:4]))
