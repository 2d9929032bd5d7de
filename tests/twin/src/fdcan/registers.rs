//! Bits, reset values and write protection of the FDCAN's registers: RM0433, chapter FDCAN, register sections.
//!
//! The addresses and names are the vendor's table in the emulator; its reset values are all zero and some of its
//! registers are marked read-only that are not (DBTP, TEST, RWD, TDCR, IR, IE, ILS), so what a register takes is
//! said here. The values are those of RM0433 as remembered; embassy's driver checks CREL and ENDN.

use rigless::soc::Layout;
use rigless::soc::stm32h743::generated::fdcan1::Register;

const RESET: &[(Register, u64)] = &[
    (Register::FdcanCrel, 0x3214_1218),
    (Register::FdcanEndn, 0x8765_4321),
    (Register::FdcanDbtp, 0x0000_0A33),
    (Register::FdcanCccr, 0x0000_0001),
    (Register::FdcanNbtp, 0x0600_0A03),
    (Register::FdcanTocc, 0xFFFF_0000),
    (Register::FdcanTocv, 0x0000_FFFF),
    (Register::FdcanPsr, 0x0000_0707),
    (Register::FdcanXidam, 0x1FFF_FFFF),
];

/// The value of each register, by its index.
#[derive(Debug)]
pub struct Registers(pub Vec<u64>);

/// As after a reset.
impl Default for Registers {
    fn default() -> Self {
        let mut values = vec![0; Register::ALL.len()];
        RESET.iter().for_each(|&(register, value)| values[register.index()] = value);
        Self(values)
    }
}

/// What becomes of a value that software writes.
pub enum Rule {
    /// The bits of this mask land.
    Bits(u64),
    /// The bits of this mask land while CCCR.CCE and CCCR.INIT are set (the "P" of the register tables).
    Protected(u64),
    /// The model does it all; nothing lands in what software may only read.
    Special,
}

/// The rule of a register. `None`: there is no model of it, time-triggered operation above all, and an access is
/// reported.
pub fn rule(register: Register) -> Option<Rule> {
    use Register as R;
    Some(match register {
        R::FdcanDbtp => Rule::Protected(0x009F_1FFF),
        R::FdcanNbtp => Rule::Protected(0xFFFF_FF7F),
        R::FdcanRwd => Rule::Protected(0x0000_00FF),
        R::FdcanTscc => Rule::Protected(0x000F_0003),
        R::FdcanTocc => Rule::Protected(0xFFFF_0007),
        R::FdcanTdcr => Rule::Protected(0x0000_7F7F),
        R::FdcanGfc => Rule::Protected(0x0000_003F),
        R::FdcanSidfc => Rule::Protected(0x00FF_FFFC),
        R::FdcanXidfc => Rule::Protected(0x007F_FFFC),
        R::FdcanXidam => Rule::Protected(0x1FFF_FFFF),
        R::FdcanRxf0c | R::FdcanRxf1c => Rule::Protected(0xFF7F_FFFC),
        R::FdcanRxbc => Rule::Protected(0x0000_FFFC),
        R::FdcanRxesc => Rule::Protected(0x0000_0777),
        R::FdcanTxbc => Rule::Protected(0x7F3F_FFFC),
        R::FdcanTxesc => Rule::Protected(0x0000_0007),
        R::FdcanTxefc => Rule::Protected(0x3F3F_FFFC),
        R::FdcanIe | R::FdcanIls => Rule::Bits(0x3FFF_FFFF),
        R::FdcanIle => Rule::Bits(0b11),
        R::FdcanTxbtie | R::FdcanTxbcie => Rule::Bits(0xFFFF_FFFF),
        // What software may only read.
        R::FdcanCrel
        | R::FdcanEndn
        | R::FdcanHpms
        | R::FdcanTxfqs
        | R::FdcanTxbrp
        | R::FdcanTxbto
        | R::FdcanTxbcf
        | R::FdcanRxf0s
        | R::FdcanRxf1s
        | R::FdcanEcr
        | R::FdcanPsr
        | R::FdcanCccr
        | R::FdcanTest
        | R::FdcanIr
        | R::FdcanTscv
        | R::FdcanTocv
        | R::FdcanRxf0a
        | R::FdcanRxf1a
        | R::FdcanTxbar
        | R::FdcanTxbcr => Rule::Special,
        _ => return None,
    })
}

pub mod cccr {
    pub const INIT: u64 = 1 << 0;
    pub const CCE: u64 = 1 << 1;
    pub const ASM: u64 = 1 << 2;
    pub const CSA: u64 = 1 << 3;
    pub const CSR: u64 = 1 << 4;
    pub const MON: u64 = 1 << 5;
    pub const DAR: u64 = 1 << 6;
    pub const TEST: u64 = 1 << 7;
    pub const FDOE: u64 = 1 << 8;
    pub const BRSE: u64 = 1 << 9;
    pub const NISO: u64 = 1 << 15;
    /// Taken only with CCE and INIT set: DAR, FDOE, BRSE, PXHD, EFBI, TXP, NISO.
    pub const PROTECTED: u64 = DAR | FDOE | BRSE | 1 << 12 | 1 << 13 | 1 << 14 | NISO;
    /// Set only with CCE and INIT set, cleared at any time.
    pub const PROTECTED_SET: u64 = ASM | MON | TEST;
}

/// TEST.LBCK, TEST.RX, and TEST.TX that holds the pin low.
pub const LOOPBACK: u64 = 1 << 4;
pub const RX: u64 = 1 << 7;
pub const TX_DOMINANT: u64 = 0b10;

/// IR, IE and ILS.
pub mod interrupt {
    /// FIFO 0: new message, watermark, full, lost; FIFO 1 four bits up.
    pub const RF0N: u64 = 1 << 0;
    pub const RF0W: u64 = 1 << 1;
    pub const RF0F: u64 = 1 << 2;
    pub const RF0L: u64 = 1 << 3;
    pub const TC: u64 = 1 << 9;
    pub const TCF: u64 = 1 << 10;
    pub const EP: u64 = 1 << 23;
    pub const EW: u64 = 1 << 24;
    pub const BO: u64 = 1 << 25;
    pub const PEA: u64 = 1 << 27;
    pub const PED: u64 = 1 << 28;
}

pub mod psr {
    pub const LEC: u64 = 0b111;
    pub const EP: u64 = 1 << 5;
    pub const EW: u64 = 1 << 6;
    pub const BO: u64 = 1 << 7;
    pub const DLEC: u64 = 0b111 << 8;
    pub const RESI: u64 = 1 << 11;
    pub const RBRS: u64 = 1 << 12;
    pub const RFDF: u64 = 1 << 13;
    pub const PXE: u64 = 1 << 14;
    pub const ACK_ERROR: u64 = 3;
    pub const BIT0_ERROR: u64 = 5;
    /// No change since the last read.
    pub const UNCHANGED: u64 = 7;
}

/// Bits `low` and up of `value`, `width` of them.
pub const fn field(value: u64, low: u32, width: u32) -> u64 {
    value >> low & ((1 << width) - 1)
}
