"""Loads DATASET/train with Hugging Face `datasets`, without a network, and looks at every row.

check_datasets.py DATASET WORK EPISODE: the first picture of EPISODE has to be WORK/first.rgb, pixel by pixel.
"""
import os
import sys

dataset, work, episode = sys.argv[1:]
os.environ["HF_HUB_OFFLINE"] = os.environ["HF_DATASETS_OFFLINE"] = "1"
os.environ["HF_HOME"] = os.path.join(work, "home")

from datasets import load_dataset
from PIL.Image import Image

rows = load_dataset("parquet", data_dir=os.path.join(dataset, "train"), split="train", cache_dir=os.path.join(work, "cache"))
with open(os.path.join(work, "first.rgb"), "rb") as file:
    first = file.read()
images, compared = 0, 0
for row in rows:
    assert [message["role"] for message in row["messages"]] == ["system", "user", "assistant"], row["messages"]
    assert row["messages"][1]["content"].count("<image>") == len(row["images"]), row["call"]
    assert row["verdict"] == "exact" and len(row["trace_digest"]) == 64, row["verdict"]
    for image in row["images"]:
        assert isinstance(image, Image) and image.size == (640, 480), type(image)
        images += 1
    if row["episode_id"] == episode and row["call"] == 0:
        assert row["images"][0].convert("RGB").tobytes() == first, "the pixels are the camera's"
        compared += 1
assert compared == 1, compared
print(f"{len(rows)} rows, {images} images of 640 x 480")
