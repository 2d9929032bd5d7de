//! Files in the emulator's working directory, through semihosting calls.

use cortex_m_semihosting::{nr, syscall};

pub struct File(usize);

/// The host's answer when a call fails.
const FAILED: usize = usize::MAX;
const NAME_MAX: usize = 32;

impl File {
    pub fn open(name: &str) -> Option<Self> {
        Self::open_as(name, nr::open::R_BINARY)
    }

    pub fn create(name: &str) -> Self {
        Self::open_as(name, nr::open::W_TRUNC_BINARY).unwrap_or_else(|| panic!("cannot create {name}"))
    }

    fn open_as(name: &str, mode: usize) -> Option<Self> {
        let mut with_end = [0u8; NAME_MAX];
        with_end[..NAME_MAX - 1][..name.len()].copy_from_slice(name.as_bytes());
        // SAFETY: the host reads `name.len()` bytes and a zero at the pointer, which live through the call.
        let handle = unsafe { syscall!(OPEN, with_end.as_ptr(), mode, name.len()) };
        (handle != FAILED).then_some(Self(handle))
    }

    /// Fill `buffer`; `None` if the file ends before.
    #[must_use]
    pub fn read_exact(&mut self, buffer: &mut [u8]) -> Option<()> {
        // SAFETY: the host writes at most `len` bytes at the pointer, all within `buffer`, which is borrowed mutably
        // through the call.
        let missing = unsafe { syscall!(READ, self.0, buffer.as_mut_ptr(), buffer.len()) };
        (missing == 0).then_some(())
    }

    pub fn write_all(&mut self, bytes: &[u8]) {
        // SAFETY: the host reads `len` bytes at the pointer, which live through the call.
        let missing = unsafe { syscall!(WRITE, self.0, bytes.as_ptr(), bytes.len()) };
        assert!(missing == 0, "the host takes the output");
    }
}
