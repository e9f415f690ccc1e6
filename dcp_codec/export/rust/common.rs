/// Why octets are not a beacon: the reasons of the test kit, by the same names.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub enum Reason {
@REASONS@
}

impl Reason {
    /// Its name in the test kit, such as `"zero-length"`.
    pub fn name(self) -> &'static str {
        match self {
@NAMES@
        }
    }
}

/// A problem in octets. The meaning of `needed` and `available` depends on the reason: octets, or the number that should
/// be there and the one that was found; 0 if there is nothing to tell.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub struct Problem {
    pub reason: Reason,
    /// The requirement that the octets break, by its identifier in the test kit; empty: none.
    pub requirement: &'static str,
    /// The name of the field in the specification, with those of the records around it.
    pub field: &'static str,
    /// The octet at which the field begins, counted from the first octet given.
    pub offset: usize,
    pub needed: u64,
    pub available: u64,
}

/// Why a value cannot be encoded, or functions were called in a wrong order.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub enum Fault {
    /// The buffer is full.
    NoRoom,
    /// A number needs more octets than its field has.
    OutOfRange,
    /// A text or a part is longer than its length can express.
    TooLong,
    /// A text that ends with a NUL octet contains one.
    Nul,
    /// There are more elements than their count can express.
    TooMany,
    /// A list that must not be empty is empty.
    Empty,
    /// The profile has no container of this type.
    UnknownType,
    /// A part was ended that was not begun, or begun twice.
    Order,
}

/// The value of a field, for programs that show all of them.
#[derive(Debug, Clone, Copy, PartialEq)]
pub enum Value<'a> {
    Unsigned(u64),
    Signed(i64),
    Real(f64),
    Octets(&'a [u8]),
}

/// The octets that are being read: `at` is the next one, `end` the first one that may not be read.
#[derive(Debug, Clone, Copy)]
struct Reader<'a> {
    octets: &'a [u8],
    at: usize,
    end: usize,
}

// Not every profile needs all of them.
#[allow(dead_code)]
impl<'a> Reader<'a> {
    fn new(octets: &'a [u8]) -> Self {
        Reader { octets, at: 0, end: octets.len() }
    }

    fn left(&self) -> usize {
        self.end - self.at
    }

    /// The next octets; `name` is for the problem.
    fn take(&mut self, size: u64, requirement: &'static str, field: &'static str) -> Result<&'a [u8], Problem> {
        let left = self.left();
        if (left as u64) < size {
            let (offset, available) = (self.at, left as u64);
            return Err(Problem { reason: Reason::Truncated, requirement, field, offset, needed: size, available });
        }
        let found = &self.octets[self.at..self.at + size as usize];
        self.at += found.len();
        Ok(found)
    }

    #[inline]
    fn array<const N: usize>(&mut self, requirement: &'static str, field: &'static str) -> Result<[u8; N], Problem> {
        let mut found = [0; N];
        found.copy_from_slice(self.take(N as u64, requirement, field)?);
        Ok(found)
    }

    #[inline]
    fn big(&mut self, size: u64, requirement: &'static str, field: &'static str) -> Result<u64, Problem> {
        let octets = self.take(size, requirement, field)?;
        Ok(octets.iter().fold(0, |value, &octet| value << 8 | u64::from(octet)))
    }

    #[inline]
    fn little(&mut self, size: u64, requirement: &'static str, field: &'static str) -> Result<u64, Problem> {
        let octets = self.take(size, requirement, field)?;
        Ok(octets.iter().rev().fold(0, |value, &octet| value << 8 | u64::from(octet)))
    }

    /// Octets up to a NUL, which is skipped.
    fn until_nul(&mut self, requirement: &'static str, field: &'static str) -> Result<&'a [u8], Problem> {
        let rest = &self.octets[self.at..self.end];
        match rest.iter().position(|&octet| octet == 0) {
            Some(size) => {
                self.at += size + 1;
                Ok(&rest[..size])
            }
            None => Err(Problem {
                reason: Reason::Truncated, requirement, field, offset: self.end, needed: 1, available: 0,
            }),
        }
    }
}

/// The number whose two's complement of so many bits is `value`.
#[allow(dead_code)]
fn signed(value: u64, bits: u32) -> i64 {
    ((value << (64 - bits)) as i64) >> (64 - bits)
}

/// Writes into a buffer of the caller. A function that fails has not changed the octets written so far. Lengths and
/// counts are set when a part is ended.
#[derive(Debug)]
pub struct Writer<'b> {
    octets: &'b mut [u8],
    at: usize,
    beacon: Option<usize>,
    payload: Option<usize>,
    container: Option<usize>,
    payloads: usize,
    content: usize,
    records: usize,
    places: [usize; 5],
    payloads_written: u64,
    records_written: u64,
    ic_type: u64,
}

#[allow(dead_code)]
const BEACON_LENGTH: usize = 0;
#[allow(dead_code)]
const NUM_PAYLOADS: usize = 1;
#[allow(dead_code)]
const PAYLOAD_LENGTH: usize = 2;
#[allow(dead_code)]
const NUM_RECORDS: usize = 3;
#[allow(dead_code)]
const LIST_LENGTH: usize = 4;

impl<'b> Writer<'b> {
    /// Begin to write into a buffer.
    pub fn new(octets: &'b mut [u8]) -> Self {
        Writer {
            octets, at: 0, beacon: None, payload: None, container: None, payloads: 0, content: 0, records: 0,
            places: [0; 5], payloads_written: 0, records_written: 0, ic_type: 0,
        }
    }

    /// The number of octets written.
    pub fn size(&self) -> usize {
        self.at
    }

    /// The octets written.
    pub fn written(&self) -> &[u8] {
        &self.octets[..self.at]
    }

    fn room(&self, size: usize) -> Result<(), Fault> {
        if self.octets.len() - self.at < size { Err(Fault::NoRoom) } else { Ok(()) }
    }

    /// Add octets to the content of a payload.
    pub fn add_octets(&mut self, octets: &[u8]) -> Result<(), Fault> {
        self.room(octets.len())?;
        self.copy(octets);
        Ok(())
    }

    fn copy(&mut self, octets: &[u8]) {
        self.octets[self.at..self.at + octets.len()].copy_from_slice(octets);
        self.at += octets.len();
    }

    fn put(&mut self, value: u64, size: usize, little: bool) {
        self.set(self.at, value, size, little);
        self.at += size;
    }

    fn set(&mut self, at: usize, value: u64, size: usize, little: bool) {
        for index in 0..size {
            let shift = 8 * if little { index } else { size - 1 - index };
            self.octets[at + index] = (value >> shift) as u8;
        }
    }
}
