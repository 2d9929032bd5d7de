//! Files of the host, through the emulator's semihosting calls. The only module that makes them.

use cortex_m_semihosting::{nr, syscall};

/// An open file.
pub struct File(usize);

/// What the host answers when a call fails.
const FAILED: usize = usize::MAX;

impl File {
    /// Open a file of the emulator's working directory for reading. `name` ends in a zero byte.
    pub fn open(name: &core::ffi::CStr) -> Option<Self> {
        Self::open_as(name, nr::open::R_BINARY)
    }

    /// Create or empty a file.
    pub fn create(name: &core::ffi::CStr) -> Option<Self> {
        Self::open_as(name, nr::open::W_TRUNC_BINARY)
    }

    fn open_as(name: &core::ffi::CStr, mode: usize) -> Option<Self> {
        // SAFETY: the host reads `count_bytes` characters at the pointer, which live through the call.
        let handle = unsafe { syscall!(OPEN, name.as_ptr(), mode, name.count_bytes()) };
        (handle != FAILED).then_some(Self(handle))
    }

    /// Fill `buffer`; `None` if the file ends before.
    #[must_use]
    pub fn read_exact(&mut self, buffer: &mut [u8]) -> Option<()> {
        // SAFETY: the host writes at most `len` bytes at the pointer, all within `buffer`, which is
        // borrowed mutably through the call.
        let missing = unsafe { syscall!(READ, self.0, buffer.as_mut_ptr(), buffer.len()) };
        (missing == 0).then_some(())
    }

    /// Append `bytes`; `None` if the host cannot take all of them.
    #[must_use]
    pub fn write_all(&mut self, bytes: &[u8]) -> Option<()> {
        // SAFETY: the host reads `len` bytes at the pointer, which live through the call.
        let missing = unsafe { syscall!(WRITE, self.0, bytes.as_ptr(), bytes.len()) };
        (missing == 0).then_some(())
    }
}
