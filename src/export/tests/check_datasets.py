"""Loads DIR/sft.parquet with Hugging Face `datasets`, without a network, and looks at every row."""
import os
import sys

folder = sys.argv[1]
os.environ["HF_HUB_OFFLINE"] = os.environ["HF_DATASETS_OFFLINE"] = "1"
os.environ["HF_HOME"] = os.path.join(folder, "home")

from datasets import load_dataset
from PIL.Image import Image

rows = load_dataset("parquet", data_files=os.path.join(folder, "sft.parquet"), split="train", cache_dir=os.path.join(folder, "cache"))
images = 0
for row in rows:
    assert [message["role"] for message in row["messages"]] == ["system", "user", "assistant"], row["messages"]
    assert row["messages"][1]["content"].count("<image>") == len(row["images"]), row["step"]
    for image in row["images"]:
        assert isinstance(image, Image) and image.size == (640, 480), type(image)
        assert image.getpixel((639, 0))[2] > image.getpixel((0, 0))[2], "the pixels are the camera's"
        images += 1
print(f"{len(rows)} rows, {images} images of 640 x 480")
