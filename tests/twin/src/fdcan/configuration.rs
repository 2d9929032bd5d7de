//! From INIT to the bus: what may be written when, bit timings, and the time stamp that counts them (RM0433, software
//! initialization, operating modes, timestamp generation).

use rigless::device::DeviceContext as Context;
use rigless::soc::FieldSpec;
use rigless::soc::stm32h743::generated::fdcan1::Register;
use rigless::time::VirtualNanos;
use slipsense_can_sim::{BitTiming, Timing};

use super::Fdcan;
use super::registers::{PROTECTED, PROTECTED_SET, cccr, dbtp, nbtp, tdcr, tscc};

impl Fdcan {
    pub(super) fn write_cccr(&mut self, value: u64, old: u64, context: &mut Context<'_>) {
        let was_init = cccr::INIT.is_set(old);
        let mut new = value & 0xF3FF & !cccr::CSA.mask();
        if !(was_init && cccr::CCE.is_set(old)) {
            let changed = (old ^ new) & PROTECTED | new & !old & PROTECTED_SET;
            if changed != 0 {
                context.tell(
                    "FDCAN_CCCR",
                    "a bit that is protected was changed without CCE and INIT, and is ignored",
                );
            }
            new = (new & !PROTECTED) | (old & PROTECTED);
            new &= !PROTECTED_SET | old;
        }
        // CCE can be set only while INIT is, and falls with it.
        if !cccr::INIT.is_set(new) || !was_init {
            if cccr::CCE.is_set(new) && !was_init {
                context.tell("FDCAN_CCCR", "CCE was set before INIT read as set, and is ignored");
            }
            new &= !cccr::CCE.mask();
        }
        if cccr::CSR.is_set(new) {
            // Clock stop request: acknowledged once the bus is idle, here at once, with INIT set.
            new |= cccr::CSA.mask() | cccr::INIT.mask();
        }
        self.set(Register::FdcanCccr, new);
        if !cccr::TEST.is_set(new) {
            // Test register: its functions fall back when CCCR.TEST falls.
            self.set(Register::FdcanTest, 0);
        }
        if cccr::CCE.is_set(new) && !cccr::CCE.is_set(old) {
            self.configuration_begins();
        }
        if cccr::INIT.is_set(new) && !was_init {
            if self.in_flight.take().is_some() {
                context.tell("FDCAN_CCCR", "INIT was set while a frame was on the bus, which is cut off");
            }
            self.start = None;
        }
        if !cccr::INIT.is_set(new) && was_init {
            self.join(context);
        }
    }

    /// Software initialization: setting CCE resets these.
    fn configuration_begins(&mut self) {
        use Register as R;
        for register in [
            R::FdcanHpms,
            R::FdcanRxf0s,
            R::FdcanRxf1s,
            R::FdcanTxbrp,
            R::FdcanTxbto,
            R::FdcanTxbcf,
            R::FdcanTxfqs,
        ] {
            self.set(register, 0);
        }
        (self.requested, self.cancelled) = ([(None, 0); 32], 0);
    }

    /// INIT was cleared: bit timings are taken, and the node joins after 11 recessive bits, or after its recovery.
    fn join(&mut self, context: &mut Context<'_>) {
        let (nominal, data) = (self.get(Register::FdcanNbtp), self.get(Register::FdcanDbtp));
        let delay_compensation = dbtp::TDC.is_set(data);
        let bit_timing = |value: u64, fields: [&FieldSpec; 3]| {
            let [prescaler, seg1, seg2] = fields.map(|field| field.get(value) as u32 + 1);
            BitTiming { prescaler, seg1, seg2 }
        };
        let nominal = bit_timing(nominal, [nbtp::NBRP, nbtp::NTSEG1, nbtp::TSEG2]);
        let data = bit_timing(data, [dbtp::DBRP, dbtp::DTSEG1, dbtp::DTSEG2]);
        let Ok(clock_hz) = u32::try_from(self.clock_hz) else { return };
        let timing = Timing { clock_hz, nominal, data };
        self.check_timing(&timing, delay_compensation, context);
        if clock_hz == 0 {
            context.tell("FDCAN_CCCR", "INIT was cleared while the kernel clock stands still");
            return;
        }
        self.timing = Some(timing);
        self.timestamp_from = context.now().0;
        if let Some(at) = self.wire_at_rx_mut().join(context.now().0, timing) {
            self.recovery = Some(context.schedule(VirtualNanos(at)));
        }
        self.update_queue();
        self.schedule_start(context);
    }

    /// Nominal and data bit time: at least 4 quanta, jump width within segment 2, and above 1 Mbit/s compensation
    /// of the transceiver's delay with a prescaler of 1 or 2 (transceiver delay compensation).
    fn check_timing(&self, timing: &Timing, compensated: bool, context: &mut Context<'_>) {
        let Timing { nominal, data, .. } = timing;
        let nsjw = nbtp::NSJW.get(self.get(Register::FdcanNbtp)) as u32 + 1;
        let dsjw = dbtp::DSJW.get(self.get(Register::FdcanDbtp)) as u32 + 1;
        if nsjw > nominal.seg2 {
            context.tell("FDCAN_NBTP", "the jump width is wider than the segment after the sample point");
        }
        if !self.has(cccr::FDOE) || !self.has(cccr::BSE) {
            return;
        }
        if dsjw > data.seg2 {
            context.tell("FDCAN_DBTP", "the jump width is wider than the segment after the sample point");
        }
        let bit_rate = self.clock_hz / u64::from(data.cycles());
        if bit_rate > 1_000_000 && !compensated {
            context.tell("FDCAN_DBTP", "more than 1 Mbit/s without transceiver delay compensation (TDC)");
        }
        if compensated && data.prescaler > 2 {
            context.tell("FDCAN_DBTP", "delay compensation needs a prescaler of 1 or 2");
        }
        if compensated && !tdcr::TDCO.is_set(self.get(Register::FdcanTdcr)) {
            context
                .tell("FDCAN_TDCR", "delay compensation with an offset of 0 samples before the sample point");
        }
    }

    /// Timestamp generation: nominal bit times over TCP + 1, 16 bits.
    pub(super) fn timestamp(&self, now_ns: u64) -> u16 {
        let tscc = self.get(Register::FdcanTscc);
        let Some(timing) = self.timing.filter(|_| tscc::TSS.get(tscc) == 1) else { return 0 };
        let step = u64::from(timing.nominal.cycles()) * (tscc::TCP.get(tscc) + 1);
        let elapsed = u128::from(now_ns - self.timestamp_from) * u128::from(timing.clock_hz) / 1_000_000_000;
        (elapsed / u128::from(step)) as u16
    }
}
