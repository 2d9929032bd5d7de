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
pub trait Scalar: bytemuck::Pod + private::Sealed {
    /// NumPy's name, for messages.
    const NAME: &'static str;
    /// NumPy's type string, little-endian.
    const DESCR: &'static str;
    /// Bytes of one element.
    const BYTES: usize = size_of::<Self>();
    /// Read one element; `bytes` holds exactly [`Scalar::BYTES`].
    #[doc(hidden)]
    fn from_le(bytes: &[u8]) -> Self;
    /// Append one element.
    #[doc(hidden)]
    fn put_le(self, to: &mut Vec<u8>);
}

mod private {
    pub trait Sealed {}
}

macro_rules! scalar {
    ($($type:ident $name:literal $descr:literal),*) => {$(
        impl private::Sealed for $type {}
        impl Scalar for $type {
            const NAME: &'static str = $name;
            const DESCR: &'static str = $descr;
            fn from_le(bytes: &[u8]) -> Self {
                let mut own = [0; size_of::<Self>()];
                own.copy_from_slice(bytes);
                Self::from_le_bytes(own)
            }
            fn put_le(self, to: &mut Vec<u8>) {
                to.extend_from_slice(&self.to_le_bytes());
            }
        }
    )*};
}

scalar!(u8 "uint8" "|u1", u16 "uint16" "<u2", i16 "int16" "<i2", u32 "uint32" "<u4", i32 "int32" "<i4", f32 "float32" "<f4");

/// Bytes moved at a time: small beside an episode, large beside a system call.
const CHUNK_BYTES: usize = 1 << 16;
