"""The paired bootstrap of `policy_comparison`, with the generator that Reel seeds: nothing that SQL has."""
import numpy


def chacha8(seed, count):
    """`count` numbers of 64 bits of ChaCha with 8 rounds, the key stretched from the seed by PCG32 (crate `rand_core`)."""
    words, mask = [], (1 << 64) - 1
    for _ in range(8):
        seed = (seed * 6364136223846793005 + 11634580027462260723) & mask
        word, turn = ((seed >> 18) ^ seed) >> 27 & 0xFFFFFFFF, seed >> 59
        words.append((word >> turn | word << (32 - turn)) & 0xFFFFFFFF)
    blocks = (count + 7) // 8
    begin = [numpy.full(blocks, word, numpy.uint32) for word in [0x61707865, 0x3320646E, 0x79622D32, 0x6B206574, *words]]
    counter = numpy.arange(blocks, dtype=numpy.uint64)
    begin += [counter.astype(numpy.uint32), (counter >> numpy.uint64(32)).astype(numpy.uint32)]
    begin += [*numpy.zeros((2, blocks), numpy.uint32)]
    x = [word.copy() for word in begin]

    def mix(a, b, c, d):
        for to, by, turned, bits in [(a, b, d, 16), (c, d, b, 12), (a, b, d, 8), (c, d, b, 7)]:
            x[to] += x[by]
            x[turned] ^= x[to]
            x[turned] = x[turned] << numpy.uint32(bits) | x[turned] >> numpy.uint32(32 - bits)

    for _ in range(4):
        for column in range(4):
            mix(column, column + 4, column + 8, column + 12)
        for column in range(4):
            mix(column, (column + 1) % 4 + 4, (column + 2) % 4 + 8, (column + 3) % 4 + 12)
    out = numpy.stack([word + start for word, start in zip(x, begin)], axis=1).astype(numpy.uint64)
    return (out[:, 0::2] | out[:, 1::2] << numpy.uint64(32)).reshape(-1)[:count]


def bootstrap(differences, samples, seed):
    """2.5 and 97.5 % percentiles of the means of resampled lists."""
    n = len(differences)
    draws = chacha8(seed, n * samples)
    half = numpy.uint64(32)
    low, high = draws & numpy.uint64(0xFFFFFFFF), draws >> half
    # floor(draw * n / 2^64) without 128 bits
    index = (high * numpy.uint64(n) + (low * numpy.uint64(n) >> half)) >> half
    means = sorted(numpy.array(differences)[index.astype(int)].reshape(samples, n).mean(axis=1))
    return [float(means[int((samples - 1) * part + 0.5)]) for part in (0.025, 0.975)]
