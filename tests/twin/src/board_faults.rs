//! What goes wrong on the board itself, when the far end asks for it: the core runs into something, the supply dips, the
//! flash raises flags of reads, a bit of the model that runs flips.
//!
//! The firmware stays as it is. To make it fault, hang or panic, the first instructions of its busiest interrupt handler,
//! [`HANDLER`], are others until the board restarts: as after a bit flip there.

use anyhow::{Result, bail};
use rigless::emulator::{Access, AccessKind, Error, Host, Stop};
use rigless::session::Session;
use rigless::soc::Width;
use rigless::soc::stm32h743::generated::flash::{Register, sr1, sr2};
use rigless::soc::stm32h743::generated::ramecc1::{self, m1sr};
use rigless::symbols::Symbols;
use slipsense::net::format::MAGIC;

use crate::machine::{Twin, registers};
use crate::power_faults::{CONTROL, FLASH};

/// The executor of acquisition and transmission.
const HANDLER: &str = "CEC";
/// The start of the firmware: taken a second time, it panics.
const START: &str = "main";
/// `udf #0`, `b .`, `nop`, and `ldr pc, [pc]`, which takes the word behind it.
const UNDEFINED: u16 = 0xDE00;
const BRANCH_TO_ITSELF: u16 = 0xE7FE;
const NOP: u16 = 0xBF00;
const JUMP: [u16; 2] = [0xF8DF, 0xF000];
/// Where the model that runs is searched, and the byte of it whose bits flip: a weight's.
const AXI_SRAM: std::ops::Range<u64> = 0x2400_0000..0x2408_0000;
const FLIPPED_AT: u64 = 90_000;
/// Flags that a read raises, of whomever (RM0433 4.7.7 to 4.7.9), by speculation too. They stand until CCR clears them,
/// and stop no operation.
const READ_FLAGS: [(Register, [u64; 3]); 2] = [
    (Register::Sr1, [sr1::RDPERR1.mask(), sr1::RDSERR1.mask(), sr1::SNECCERR.mask()]),
    (Register::Sr2, [sr2::RDPERR2.mask(), sr2::RDSERR2.mask(), sr2::SNECCERR2.mask()]),
];

/// The firmware's handler and start; and what has been changed.
#[derive(Debug, Default)]
pub struct BoardFaults {
    handler: u64,
    start: u64,
    /// Halfwords that were at the handler, by address.
    changed: Vec<(u64, u64)>,
    /// Of a million writes to the flash and its control registers, how many meet a flag.
    flags_per_million: u64,
    random: u64,
    pub flags: u64,
}

impl BoardFaults {
    pub fn new(symbols: &Symbols) -> Self {
        let address = |name| symbols.get(name).map_or(0, |address| address & !1);
        Self { handler: address(HANDLER), start: address(START), random: 0x9E37_79B9, ..Self::default() }
    }

    /// What the far end asks for: `hard fault`, `hang`, `panic`, `brown-out`, `model bit`, or `flags N`, of a million.
    pub fn order(
        &mut self,
        text: &str,
        session: &mut Session<Twin>,
        host: &mut dyn Host,
        stop: Stop,
    ) -> Result<()> {
        match text {
            "hard fault" => self.change(host, &[UNDEFINED])?,
            "hang" => self.change(host, &[BRANCH_TO_ITSELF])?,
            "panic" => {
                let start = self.start as u32 | 1;
                let align = if self.handler.is_multiple_of(4) { &[][..] } else { &[NOP] };
                let target = [start as u16, (start >> 16) as u16];
                self.change(host, &[align, &JUMP, &target].concat())?;
            }
            "brown-out" => {
                session.board_mut().mcu.is_brown_out = true;
                session.reset_by_pin(stop.at, stop.instruction_count, host);
            }
            "model bit" => {
                let begins = |&at: &u64| {
                    let [first, second] = [at, at + 4].map(|at| host.read(at, Width::W32).unwrap_or(0));
                    (first | second << 32).to_le_bytes() == MAGIC
                };
                let Some(model) = AXI_SRAM.step_by(4).find(begins) else { bail!("there is no model in RAM") };
                let held = host.read(model + FLIPPED_AT, Width::W8)?;
                host.write(model + FLIPPED_AT, Width::W8, held ^ 1)?;
                // The emulator has the registers of the monitors, and no error correction.
                let monitor = registers(&mut session.board_mut().mcu.part, "RAMECC1");
                monitor.set(ramecc1::Register::M1sr, m1sr::DEDF.mask());
            }
            _ => match text.strip_prefix("flags ").and_then(|number| number.parse().ok()) {
                Some(per_million) => self.flags_per_million = per_million,
                None => bail!("the far end asks for {text:?}"),
            },
        }
        Ok(())
    }

    fn change(&mut self, host: &mut dyn Host, halfwords: &[u16]) -> Result<()> {
        if self.handler == 0 || self.start == 0 {
            bail!("the program has no {HANDLER} or no {START}");
        }
        for (address, &halfword) in (self.handler..).step_by(2).zip(halfwords) {
            self.changed.push((address, host.read(address, Width::W16)?));
            host.program(address, Width::W16, halfword.into())?;
        }
        Ok(())
    }

    /// After each restart of the board: the handler is as it was.
    pub fn restarted(&mut self, host: &mut dyn Host) -> Result<(), Error> {
        self.changed.drain(..).try_for_each(|(address, held)| host.program(address, Width::W16, held))
    }

    /// After each access of the core.
    pub fn look(&mut self, session: &mut Session<Twin>, access: Access) {
        let of_flash = FLASH.contains(&access.address) || CONTROL.contains(&access.address);
        if access.kind != AccessKind::Write || !of_flash {
            return;
        }
        // xorshift64: the same flags in every run.
        self.random ^= self.random << 13;
        self.random ^= self.random >> 7;
        self.random ^= self.random << 17;
        if self.random % 1_000_000 >= self.flags_per_million {
            return;
        }
        let [bank, kind] = [self.random >> 32 & 1, (self.random >> 40) % 3].map(|number| number as usize);
        let (register, flags) = READ_FLAGS[bank];
        registers(&mut session.board_mut().mcu.part, "Flash").restore(register, flags[kind], flags[kind]);
        self.flags += 1;
    }
}
