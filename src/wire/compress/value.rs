//! Values of up to 16 bits as one of 40 symbols and a few extra bits: 0 to 15 are a symbol each, above that each
//! half octave is one. So a context has a short table of frequencies whatever the range of the sensor.

/// Values with a symbol of their own.
pub(super) const DIRECT: u32 = 16;
/// log2 of it.
const DIRECT_BITS: u32 = 4;
/// Symbols: two for each octave from 16 to 65,535.
pub const SYMBOLS: usize = DIRECT as usize + 2 * (16 - DIRECT_BITS as usize);

/// Of each symbol in one context, the sum of the frequencies before it and its own. All together are 4096.
pub type Table = [[u16; 2]; SYMBOLS];

/// Symbol of a value of 16 bits, and how many of its low bits follow.
#[inline]
pub fn split(value: u32) -> (usize, u32) {
    if value < DIRECT {
        return (value as usize, 0);
    }
    // The lowest bit changes nothing here, and saves the check for 0.
    let top = (value | 1).ilog2();
    let extra = top - 1;
    // 2 or 3 is left: the leading one and the half of the octave.
    ((DIRECT + 2 * (top - DIRECT_BITS) + (value >> extra) - 2) as usize, extra)
}

/// Smallest value of a symbol, and how many low bits are still to come.
#[inline]
pub(super) fn join(symbol: usize) -> (u32, u32) {
    let symbol = symbol as u32;
    if symbol < DIRECT {
        return (symbol, 0);
    }
    let (octave, half) = ((symbol - DIRECT) / 2, symbol & 1);
    let extra = octave + DIRECT_BITS - 1;
    ((2 + half) << extra, extra)
}

/// Signed to unsigned, small stays small: 0, -1, 1, -2, 2 become 0, 1, 2, 3, 4.
#[inline]
pub(super) const fn fold(signed: i32) -> u32 {
    ((signed << 1) ^ (signed >> 31)) as u32
}

/// The reverse of [`fold`].
#[inline]
pub(super) const fn unfold(folded: u32) -> i32 {
    (folded >> 1) as i32 ^ -((folded & 1) as i32)
}

/// How large a number is, two steps an octave: 2 for 0, 4 for 1, 5 for 2, 6 for 3 and 4, 7 for 5 and 6. 3 is none.
#[inline]
const fn size(number: u32) -> usize {
    let number = number + 1;
    let top = u32::BITS - 1 - number.leading_zeros();
    (2 * top + ((number << 1) >> top)) as usize
}

/// Steps of half an octave that a number of 31 bits has.
const SIZES: usize = 64;

/// The tables of some contexts by size of a number, the last one for all that are larger.
pub(super) struct BySize([&'static Table; SIZES]);

impl BySize {
    pub(super) const fn new(tables: &'static [Table]) -> Self {
        let mut all = [&tables[0]; SIZES];
        let mut at = size(1);
        while at < SIZES {
            let context = at - size(1) + 1;
            all[at] = &tables[if context < tables.len() { context } else { tables.len() - 1 }];
            at += 1;
        }
        Self(all)
    }

    /// The table that belongs to a number below 2^31.
    #[inline(always)]
    pub(super) const fn get(&self, number: u32) -> &'static Table {
        self.0[size(number) % SIZES]
    }
}
