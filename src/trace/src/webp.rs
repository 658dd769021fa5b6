//! Frames as lossless WebP, by its published
//! [specification](https://developers.google.com/speed/webp/docs/webp_lossless_bitstream_specification).
//!
//! The bytes of an image are bytes of a trace: a packed episode, and an image that is drawn again,
//! have to give them once more. This encoder writes what `image-webp` 0.2 writes on 64 bits, with
//! which traces were recorded before: each pixel predicted by the one above, runs of equal
//! residuals, and one Huffman code a channel. Of equally frequent symbols the order of the standard
//! library's heap and sort decides: tests hold the digests of images, so that a compiler with
//! another order is noticed.

use std::collections::BinaryHeap;

use wide::u32x8;

/// The most pixels that one token repeats.
const RUN_MAX: usize = 4_096;
/// First symbol of the green channel that says how often the last pixel is repeated.
const FIRST_RUN: usize = 256;
/// Symbols of the green channel: values and lengths of runs.
const GREEN_SYMBOLS: usize = 280;
/// Counted with the symbols of the green channel: a pixel that is not repeated.
const NO_RUN: usize = GREEN_SYMBOLS;
/// The longest code of a symbol, in bits.
const CODE_BITS_MAX: usize = 15;
/// More than the bytes before the tokens: few beside the codes of the lengths of all symbols.
const HEADER_BYTES_MAX: usize = 1_024;
/// The longest token: a code for each channel, and one for a run with its length.
const TOKEN_BYTES_MAX: usize = (4 * CODE_BITS_MAX + 11).div_ceil(8);
/// The longest code of the length of a code, in bits.
const LENGTH_BITS_MAX: usize = 7;
/// The order in which the lengths of codes are described (the last ones are not used).
const LENGTH_ORDER: [usize; 19] = [
    17, 18, 0, 1, 2, 3, 4, 5, 16, 6, 7, 8, 9, 10, 11, 12, 13, 14, 15,
];

/// Encodes 8-bit RGB, row by row from the top left; both sides are from 1 to 16384.
pub(crate) fn encode(rgb: &[u8], width: u32, height: u32) -> Vec<u8> {
    let changes = changes(rgb, width as usize);
    let frequencies = Frequencies::of(&changes);
    let mut bits = BitWriter::default();
    bits.reserve(HEADER_BYTES_MAX);
    bits.write(0x2f, 8);
    bits.write(u64::from(width - 1), 14);
    bits.write(u64::from(height - 1), 14);
    bits.write(0, 1 + 3); // no alpha, version
    bits.write(0b101, 3); // green is subtracted from red and blue
    bits.write(0b11_1001, 6); // pixels are predicted, in one block
    bits.write(0, 1);
    write_single(&mut bits, 2); // by the one above
    (0..4).for_each(|_| write_single(&mut bits, 0));
    bits.write(0, 3); // no more transforms, no cache of colours, one set of codes
    let mut green = Code::write(&mut bits, &frequencies.green[..GREEN_SYMBOLS]);
    green.symbols.push(Symbol::default()); // NO_RUN
    let red = Code::write(&mut bits, &frequencies.red);
    let blue = Code::write(&mut bits, &frequencies.blue);
    write_single(&mut bits, 0); // alpha
    write_single(&mut bits, 1); // runs repeat the pixel before
    let long_runs = (width * height) as usize / RUN_MAX;
    bits.reserve((changes.len() + long_runs) * TOKEN_BYTES_MAX);
    tokens(&changes, |[r, g, b], run| {
        bits.write_codes([green.symbols[g], red.symbols[r], blue.symbols[b]]);
        let Run { symbol, extra_bits } = RUNS[run];
        let symbol = green.symbols[usize::from(symbol)];
        let extra = (run as u64).saturating_sub(1) & ((1 << extra_bits) - 1);
        bits.write(
            u64::from(symbol.code()) | extra << symbol.bits(),
            symbol.bits() + usize::from(extra_bits),
        );
    });
    container(bits.finish())
}

fn container(image: Vec<u8>) -> Vec<u8> {
    let padding = image.len() % 2;
    let mut bytes = Vec::with_capacity(image.len() + 21);
    bytes.extend(b"RIFF");
    bytes.extend(((image.len() + padding + 12) as u32).to_le_bytes());
    bytes.extend(b"WEBPVP8L");
    bytes.extend((image.len() as u32).to_le_bytes());
    bytes.extend(&image);
    bytes.extend(std::iter::repeat_n(0, padding));
    bytes
}

/// Gives the residuals of an image, row by row: each pixel (red less green, green, blue less green)
/// less the pixel above it. In the first row it is the pixel before that is subtracted.
fn residuals(rgb: &[u8], width: usize, mut take: impl FnMut(&[u32])) {
    let (mut above, mut row) = (vec![0; width], vec![0; width]);
    let mut residuals = vec![0; width];
    for (index, pixels) in rgb.chunks_exact(width * 3).enumerate() {
        unpack(pixels, &mut row);
        for value in &mut row {
            let green = (*value >> 8) & 0xff;
            *value = subtract_bytes(*value, green << 16 | green);
        }
        if index == 0 {
            above[1..].copy_from_slice(&row[..width - 1]);
        }
        for ((residual, value), above) in residuals.iter_mut().zip(&row).zip(&above) {
            *residual = subtract_bytes(*value, *above);
        }
        take(&residuals);
        std::mem::swap(&mut above, &mut row);
    }
}

/// Pixels of three bytes, each into the lower bytes of a number; four at a time, which is quicker.
fn unpack(pixels: &[u8], row: &mut [u32]) {
    let (fours, rest) = pixels.as_chunks::<12>();
    let (rows, last) = row.as_chunks_mut::<4>();
    for (four, values) in fours.iter().zip(rows) {
        let word =
            |at: usize| u32::from_le_bytes([four[at], four[at + 1], four[at + 2], four[at + 3]]);
        let [first, second, third] = [word(0), word(4), word(8)];
        *values = [
            first & 0xff_ffff,
            first >> 24 | (second & 0xffff) << 8,
            second >> 16 | (third & 0xff) << 16,
            third >> 8,
        ];
    }
    for (value, pixel) in last.iter_mut().zip(rest.chunks_exact(3)) {
        *value = u32::from_le_bytes([pixel[0], pixel[1], pixel[2], 0]);
    }
}

/// Subtracts each byte by itself, modulo 256.
fn subtract_bytes(value: u32, less: u32) -> u32 {
    const HIGH: u32 = 0x8080_8080;
    ((value | HIGH) - (less & !HIGH)) ^ ((value ^ !less) & HIGH)
}

/// A pixel that differs from the one before.
struct Change {
    residual: u32,
    /// Its number, row by row.
    pixel: u32,
}

/// The pixels of an image that differ from the one before, and the end.
fn changes(rgb: &[u8], width: usize) -> Vec<Change> {
    let mut changes = Vec::with_capacity(rgb.len() / 12);
    let (mut first, mut before) = (0, 0);
    residuals(rgb, width, |row| {
        for some in row.chunks(64) {
            let mut differing = differing(before, some);
            if first == 0 {
                differing |= 1;
            }
            while differing != 0 {
                let next = differing.trailing_zeros();
                changes.push(Change {
                    residual: some[next as usize],
                    pixel: first + next,
                });
                differing &= differing - 1;
            }
            first += some.len() as u32;
            before = some[some.len() - 1];
        }
    });
    changes.push(Change {
        residual: 0,
        pixel: first,
    });
    changes
}

/// A bit for each of at most 64 pixels: whether it differs from the one before.
fn differing(before: u32, pixels: &[u32]) -> u64 {
    let mut differing = u64::from(pixels[0] != before);
    let eights = pixels[1..].chunks_exact(8);
    let rest = eights.remainder();
    let mut at = 1;
    for (now, before) in eights.zip(pixels.chunks_exact(8)) {
        let [now, before] = [now, before].map(u32x8::from);
        differing |= u64::from(!now.simd_eq(before).to_bitmask() & 0xff) << at;
        at += 8;
    }
    for (now, before) in rest.iter().zip(&pixels[at - 1..]) {
        differing |= u64::from(now != before) << at;
        at += 1;
    }
    differing
}

/// Gives each token: the symbols of its pixel (red, green, blue), and how often the pixel follows.
fn tokens(changes: &[Change], mut take: impl FnMut([usize; 3], usize)) {
    for pair in changes.windows(2) {
        let [red, green, blue, _] = pair[0].residual.to_le_bytes();
        let symbols = [red, green, blue].map(usize::from);
        let mut pixel = pair[0].pixel;
        while pixel < pair[1].pixel {
            let run = (pair[1].pixel - pixel - 1).min(RUN_MAX as u32);
            take(symbols, run as usize);
            pixel += run + 1;
        }
    }
}

/// How a run is written: a symbol of the green channel, and so many low bits of the number that is
/// one less than the length of the run.
#[derive(Clone, Copy)]
struct Run {
    symbol: u16,
    extra_bits: u16,
}

/// By the length of a run. None is a symbol of its own, which has no code.
static RUNS: [Run; RUN_MAX + 1] = {
    let none = Run {
        symbol: NO_RUN as u16,
        extra_bits: 0,
    };
    let mut runs = [none; RUN_MAX + 1];
    let mut run = 1;
    while run <= RUN_MAX {
        let less = run - 1;
        let (symbol, extra_bits) = if less < 4 {
            (less, 0)
        } else {
            let highest = less.ilog2() as usize;
            (2 * highest + ((less >> (highest - 1)) & 1), highest - 1)
        };
        runs[run] = Run {
            symbol: (FIRST_RUN + symbol) as u16,
            extra_bits: extra_bits as u16,
        };
        run += 1;
    }
    runs
};

/// How often each symbol of each channel is in an image.
struct Frequencies {
    green: [u32; GREEN_SYMBOLS + 1],
    red: [u32; 256],
    blue: [u32; 256],
}

impl Frequencies {
    fn of(changes: &[Change]) -> Self {
        let mut frequencies = Self {
            green: [0; GREEN_SYMBOLS + 1],
            red: [0; 256],
            blue: [0; 256],
        };
        tokens(changes, |[red, green, blue], run| {
            frequencies.red[red] += 1;
            frequencies.green[green] += 1;
            frequencies.blue[blue] += 1;
            frequencies.green[usize::from(RUNS[run].symbol)] += 1;
        });
        frequencies
    }
}

/// The code of a symbol in its low 16 bits, with its length in bits above.
#[derive(Clone, Copy, Default)]
struct Symbol(u32);

impl Symbol {
    fn code(self) -> u32 {
        self.0 & 0xffff
    }

    fn bits(self) -> usize {
        (self.0 >> 16) as usize
    }
}

/// The Huffman code of a channel. Of one symbol alone nothing is written.
struct Code {
    symbols: Vec<Symbol>,
}

impl Code {
    /// Makes the code for symbols of given frequencies, and writes its description.
    fn write(bits: &mut BitWriter, frequencies: &[u32]) -> Self {
        let Some(code) = Self::of(frequencies, CODE_BITS_MAX) else {
            let symbol = frequencies.iter().position(|frequency| *frequency > 0);
            write_single(bits, symbol.unwrap_or(0) as u64);
            let symbols = vec![Symbol::default(); frequencies.len()];
            return Self { symbols };
        };
        let mut lengths = [0; CODE_BITS_MAX + 1];
        for symbol in &code.symbols {
            lengths[symbol.bits()] += 1;
        }
        let described = Self::of(&lengths, LENGTH_BITS_MAX);
        bits.write(0, 1); // a code of many symbols
        bits.write(LENGTH_ORDER.len() as u64 - 4, 4);
        for length in LENGTH_ORDER {
            let there = lengths.get(length).is_some_and(|count| *count > 0);
            let written = match &described {
                _ if !there => 0,
                Some(described) => described.symbols[length].bits(),
                None => 1,
            };
            bits.write(written as u64, 3);
        }
        if frequencies.len() == 256 {
            bits.write(0b111, 4); // the number of symbols follows, in 8 bits
            bits.write(254, 8);
        } else {
            bits.write(0, 1); // all symbols that there are
        }
        for symbol in &code.symbols {
            if let Some(described) = &described {
                bits.write_codes([described.symbols[symbol.bits()]]);
            }
        }
        code
    }

    /// The code for symbols of given frequencies; none where there are fewer than two.
    fn of(frequencies: &[u32], bits_max: usize) -> Option<Self> {
        let mut lengths = code_lengths(frequencies)?;
        if lengths.iter().any(|length| *length > bits_max) {
            limit(&mut lengths, frequencies, bits_max);
        }
        let mut symbols = vec![Symbol::default(); lengths.len()];
        let mut next = 0_u32;
        for bits in 1..=bits_max {
            for (symbol, _) in symbols
                .iter_mut()
                .zip(&lengths)
                .filter(|(_, length)| **length == bits)
            {
                let code = (next as u16).reverse_bits() >> (16 - bits);
                *symbol = Symbol((bits as u32) << 16 | u32::from(code));
                next += 1;
            }
            next <<= 1;
        }
        Some(Self { symbols })
    }
}

/// A node of the tree that a Huffman code is made by. Which of two equally frequent nodes leaves the
/// heap first is up to the standard library, and the same in every run.
#[derive(PartialEq, Eq)]
struct Node {
    frequency: u32,
    index: usize,
}

impl Ord for Node {
    fn cmp(&self, other: &Self) -> std::cmp::Ordering {
        other.frequency.cmp(&self.frequency)
    }
}

impl PartialOrd for Node {
    fn partial_cmp(&self, other: &Self) -> Option<std::cmp::Ordering> {
        Some(self.cmp(other))
    }
}

/// The length of each symbol's code; none where fewer than two symbols occur.
fn code_lengths(frequencies: &[u32]) -> Option<Vec<usize>> {
    let leaves = frequencies.iter().enumerate();
    let mut heap: BinaryHeap<Node> = leaves
        .filter(|(_, frequency)| **frequency > 0)
        .map(|(index, &frequency)| Node { frequency, index })
        .collect();
    if heap.len() < 2 {
        return None;
    }
    let mut inner = Vec::with_capacity(heap.len());
    while heap.len() > 1 {
        let least = heap.pop()?;
        let mut next = heap.peek_mut()?;
        inner.push([least.index, next.index]);
        *next = Node {
            frequency: least.frequency + next.frequency,
            index: frequencies.len() + inner.len() - 1,
        };
    }
    let mut lengths = vec![0; frequencies.len()];
    let mut depths = vec![0; inner.len()];
    // A node is made after those below it.
    for (index, below) in inner.iter().enumerate().rev() {
        for &node in below {
            match node.checked_sub(frequencies.len()) {
                None => lengths[node] = depths[index] + 1,
                Some(node) => depths[node] = depths[index] + 1,
            }
        }
    }
    Some(lengths)
}

/// Shortens codes to at most so many bits: others get longer, and the rarest the longest.
fn limit(lengths: &mut [usize], frequencies: &[u32], bits_max: usize) {
    let mut counts = [0_u32; CODE_BITS_MAX + 1];
    for length in lengths.iter().filter(|length| **length > 0) {
        counts[*length.min(&bits_max)] += 1;
    }
    let space = |counts: &[u32]| -> u32 {
        let taken = (1..=bits_max).map(|bits| counts[bits] << (bits_max - bits));
        taken.sum()
    };
    for _ in 1 << bits_max..space(&counts) {
        let shorter = (1..bits_max).rev().find(|bits| counts[*bits] > 0);
        let shorter = shorter.expect("codes of full length alone fit");
        counts[shorter] -= 1;
        counts[bits_max] -= 1;
        counts[shorter + 1] += 2;
    }
    // Which of equally rare symbols comes first depends on the type that is sorted: this one is as
    // the library's on 64 bits.
    let mut rare_first: Vec<(u64, u32)> = (0..).zip(frequencies.iter().copied()).collect();
    rare_first.sort_unstable_by_key(|(_, frequency)| *frequency);
    let mut bits = bits_max;
    for (symbol, _) in rare_first
        .into_iter()
        .filter(|(_, frequency)| *frequency > 0)
    {
        while counts[bits] == 0 {
            bits -= 1;
        }
        lengths[symbol as usize] = bits;
        counts[bits] -= 1;
    }
}

/// Describes the code of a channel that has one symbol.
fn write_single(bits: &mut BitWriter, symbol: u64) {
    bits.write(1, 2); // a short description, of one symbol
    if symbol <= 1 {
        bits.write(0, 1);
        bits.write(symbol, 1);
    } else {
        bits.write(1, 1);
        bits.write(symbol, 8);
    }
}

/// Bits, the lowest of a byte first.
#[derive(Default)]
struct BitWriter {
    /// Longer than what is written.
    bytes: Vec<u8>,
    /// Whole bytes that are written.
    length: usize,
    /// Bits behind these, fewer than 8 between writes.
    buffer: u64,
    held: usize,
}

impl BitWriter {
    /// Makes room, which writing does not.
    fn reserve(&mut self, bytes: usize) {
        self.bytes.resize(self.length + bytes + size_of::<u64>(), 0);
    }

    /// Writes the `count` low bits, at most 56, of which no higher one is set.
    fn write(&mut self, bits: u64, count: usize) {
        self.buffer |= bits << self.held;
        self.held += count;
        self.bytes[self.length..][..size_of::<u64>()].copy_from_slice(&self.buffer.to_le_bytes());
        self.length += self.held / 8;
        self.buffer >>= self.held / 8 * 8;
        self.held %= 8;
    }

    fn write_codes<const N: usize>(&mut self, symbols: [Symbol; N]) {
        let (mut bits, mut count) = (0, 0);
        for symbol in symbols {
            bits |= u64::from(symbol.code()) << count;
            count += symbol.bits();
        }
        self.write(bits, count);
    }

    fn finish(mut self) -> Vec<u8> {
        self.bytes.truncate(self.length + self.held.div_ceil(8));
        self.bytes
    }
}

#[cfg(test)]
mod tests {
    use reel_world::Digest;

    use super::*;

    /// The bytes that `image-webp` writes for the same pixels.
    fn reference(rgb: &[u8], width: u32, height: u32) -> Vec<u8> {
        let mut bytes = Vec::new();
        image_webp::WebPEncoder::new(&mut bytes)
            .encode(rgb, width, height, image_webp::ColorType::Rgb8)
            .unwrap();
        bytes
    }

    fn draw(state: &mut u64) -> u32 {
        *state = state
            .wrapping_mul(6_364_136_223_846_793_005)
            .wrapping_add(1);
        (*state >> 33) as u32
    }

    /// An image of surfaces, ramps and noise, each more or less of it by its seed.
    fn image(seed: u64, width: u32, height: u32) -> Vec<u8> {
        let mut state = seed;
        let (kind, noise) = (draw(&mut state) % 4, draw(&mut state) % 30);
        let mut surface = [0, 0, 0];
        let mut rgb = Vec::new();
        for y in 0..height {
            for x in 0..width {
                if kind > 0 && draw(&mut state).is_multiple_of(97) {
                    surface = [0; 3].map(|_: u32| draw(&mut state) % 256);
                }
                for (channel, value) in surface.iter().enumerate() {
                    let ramp = if kind == 2 { x / 3 + y / 5 } else { 0 };
                    // rare and rarer: codes that are longer than allowed
                    let odd = draw(&mut state).leading_zeros() * noise * (channel as u32 % 2 + 1);
                    let random = if noise > 25 { draw(&mut state) } else { odd };
                    let random = if kind == 3 { draw(&mut state) } else { random };
                    rgb.push((value + ramp + random) as u8);
                }
            }
        }
        rgb
    }

    #[test]
    fn the_bytes_of_the_library() {
        let sizes = [
            (1, 1),
            (1, 9),
            (9, 1),
            (2, 2),
            (17, 5),
            (64, 48),
            (640, 480),
        ];
        for (width, height) in sizes {
            for seed in 0..24 {
                let rgb = image(seed, width, height);
                assert!(
                    encode(&rgb, width, height) == reference(&rgb, width, height),
                    "{width} x {height}, seed {seed}"
                );
            }
            let grey = vec![77; (width * height * 3) as usize];
            assert!(encode(&grey, width, height) == reference(&grey, width, height));
        }
    }

    /// An image whose green residuals occur as often as Fibonacci numbers say, which makes the longest
    /// codes that there are; red ones alternate, so that no pixel is a run's.
    fn fibonacci() -> Vec<u8> {
        const PIXELS: usize = 640 * 480;
        let (mut symbols, mut now, mut next) = (Vec::new(), 1, 1);
        for symbol in 0_u8.. {
            let rest = PIXELS - symbols.len();
            symbols.extend(std::iter::repeat_n(symbol, rest.min(now)));
            (now, next) = (next, now + next);
            if symbols.len() == PIXELS {
                break;
            }
        }
        let mut values = vec![[0_u8; 2]; PIXELS];
        for pixel in 0..PIXELS {
            let above = match pixel {
                0 => [0, 0],
                1..640 => values[pixel - 1],
                _ => values[pixel - 640],
            };
            let residual = [(pixel % 2) as u8, symbols[pixel]];
            values[pixel] = [0, 1].map(|channel| residual[channel].wrapping_add(above[channel]));
        }
        let rgb = |[red, green]: [u8; 2]| [red.wrapping_add(green), green, green];
        values.into_iter().flat_map(rgb).collect()
    }

    #[test]
    fn long_codes_are_shortened_as_the_library_does() {
        let rgb = fibonacci();
        let frequencies = Frequencies::of(&changes(&rgb, 640));
        let lengths = code_lengths(&frequencies.green[..GREEN_SYMBOLS]).unwrap();
        assert!(lengths.iter().max() > Some(&(CODE_BITS_MAX + 5)));
        assert!(encode(&rgb, 640, 480) == reference(&rgb, 640, 480));
    }

    #[test]
    fn bytes_that_traces_hold() {
        let digest = |rgb: &[u8]| Digest::of(&encode(rgb, 640, 480)).to_string();
        let images = [fibonacci(), image(20, 640, 480), image(23, 640, 480)];
        assert_eq!(images.map(|rgb| digest(&rgb)[..16].to_owned()), DIGESTS);
    }

    const DIGESTS: [&str; 3] = ["ffaa5fbc79528fd2", "538a7b372a703791", "ed746d7af848a8a6"];
}
