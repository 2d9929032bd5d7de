//! Bits, reset values and write protection of the FDCAN's registers: RM0433, chapter FDCAN, register sections.
//!
//! Addresses, names and fields are the vendor's table in the emulator, where BRSE is BSE and RFDF is REDL. Some fields of
//! FIFO 0 are too wide there, so FIFO 1's serve both. Its reset values are all zero and some of its registers are marked
//! read-only that are not (DBTP, TEST, RWD, TDCR, IR, IE, ILS), so what a register takes is said here. The values are
//! those of RM0433 as remembered; embassy's driver checks CREL and ENDN.

use rigless::soc::Layout;
use rigless::soc::stm32h743::generated::fdcan1::Register;
pub use rigless::soc::stm32h743::generated::fdcan1::{
    fdcan_cccr as cccr, fdcan_dbtp as dbtp, fdcan_gfc as gfc, fdcan_ir as interrupt, fdcan_nbtp as nbtp,
    fdcan_psr as psr, fdcan_rxf1c as rxfc, fdcan_rxf1s as rxfs, fdcan_sidfc as sidfc, fdcan_tdcr as tdcr,
    fdcan_test as pins, fdcan_tscc as tscc, fdcan_txbc as txbc, fdcan_xidfc as xidfc,
};

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

/// The value of each register after a reset, by its index.
pub fn reset() -> Vec<u64> {
    let mut values = vec![0; Register::ALL.len()];
    RESET.iter().for_each(|&(register, value)| values[register.index()] = value);
    values
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
        R::FdcanNdat1 | R::FdcanNdat2 | R::FdcanTxefs | R::FdcanTxefa => return None,
        _ if register.index() >= R::FdcanTttmc.index() => return None,
        _ => Rule::Special,
    })
}

/// CCCR: taken only with CCE and INIT set: DAR, FDOE, BRSE, PXHD, EFBI, TXP, NISO.
pub const PROTECTED: u64 = 0xF340;
/// Set only with CCE and INIT set, cleared at any time: ASM, MON, TEST.
pub const PROTECTED_SET: u64 = 0x00A4;
/// TEST.TX that holds the pin low.
pub const TX_DOMINANT: u64 = 0b10;
/// PSR.LEC and DLEC; the last: no change since the last read.
pub const ACK_ERROR: u64 = 3;
pub const BIT0_ERROR: u64 = 5;
pub const UNCHANGED: u64 = 7;
