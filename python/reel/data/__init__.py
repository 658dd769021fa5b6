"""Rows of a store as samples for training: for PyTorch, for `datasets`, and for plain loops.

    dataset = store.dataset("SELECT episode_id, step, tool, argument, reward FROM steps", images="auto")
    dataset[0]                      # a dictionary: the columns, and `frame`, `verdict`, `digest`
    DataLoader(dataset, batch_size=32, num_workers=4, collate_fn=reel.data.collate)

    samples = dataset.iterable(batch_size=32, shuffle_seed=7)
    DataLoader(samples, batch_size=32, num_workers=4, collate_fn=reel.data.collate)

PyTorch and `datasets` are optional: indexing and iteration work without them.
"""

from ._collate import collate
from ._dataset import Dataset
from ._iterable import IterableDataset
from ._options import Images, Moment, Sample, Transform, Verify

__all__ = ["Dataset", "Images", "IterableDataset", "Moment", "Sample", "Transform", "Verify", "collate"]
