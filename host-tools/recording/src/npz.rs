//! NumPy `.npz` archives: `.npy` arrays in a zip, stored or deflated.
//!
//! The zip layer is the `zip` crate. The `.npy` header is read here, because a shape from outside must
//! be refused before anything is multiplied or allocated with it; only the five scalar types that this
//! project stores are read, little-endian and in C order, which is what `numpy.savez` writes.

mod header;
mod read;
mod write;

pub use read::{Array, Reader};
pub use write::{Writer, write_file};

/// A scalar type of an array.
pub trait Scalar: bytemuck::Pod {
    /// NumPy's name, for messages.
    const NAME: &'static str;
    /// NumPy's type string, little-endian.
    const DESCR: &'static str;

    /// From this machine's order of bytes to little-endian, or back.
    #[doc(hidden)]
    fn swap_le(self) -> Self;
}

macro_rules! scalar {
    ($($type:ident $name:literal $descr:literal),*) => {$(
        impl Scalar for $type {
            const NAME: &'static str = $name;
            const DESCR: &'static str = $descr;

            fn swap_le(self) -> Self {
                Self::from_le_bytes(self.to_ne_bytes())
            }
        }
    )*};
}

scalar!(u8 "uint8" "|u1", u16 "uint16" "<u2", i16 "int16" "<i2", u32 "uint32" "<u4", i32 "int32" "<i4", f32 "float32" "<f4");

/// Bytes moved at a time: small beside an episode, large beside a system call.
const CHUNK_BYTES: usize = 1 << 16;
