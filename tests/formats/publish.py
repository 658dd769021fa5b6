"""Published datasets as PyPI `datasets` loads them: by the card alone, with their splits and features, every image decoded, without a
network.

    python3 tests/formats/publish.py FOLDER SPLIT=ROWS... [--images]
"""

import os
import sys
import tempfile

os.environ["HF_HUB_OFFLINE"] = "1"
import datasets


def main():
    folder, *wanted = sys.argv[1:]
    images = "--images" in wanted
    wanted = {split: int(rows) for split, rows in (item.split("=") for item in wanted if item != "--images")}
    with tempfile.TemporaryDirectory() as cache:
        parts = datasets.load_dataset(folder, "default", cache_dir=cache)
        found = {split: part.num_rows for split, part in parts.items()}
        assert found == wanted, f"{found}, expected {wanted}"
        for split, part in parts.items():
            assert part.column_names, split
            decoded = 0
            for row in part:
                if images:
                    decoded += sum(image.size[0] > 0 for image in row["images"])
            assert decoded or not images, f"{split}: no image"
            print(f"{split}: {part.num_rows} rows, {len(part.column_names)} columns, {decoded} images")


main()
