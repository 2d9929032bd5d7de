//! The independent watchdog, IWDG1 (RM0433, independent watchdog; the emulator has the part's clock for it and the flag
//! of its reset, but no model of it).
//!
//! | what | behaviour | RM0433, IWDG |
//! |---|---|---|
//! | key 0xCCCC | starts the counter at 0xFFF, once; asks for the LSI, which clocks it from then on | functional description |
//! | key 0xAAAA | loads the counter from the reload value; above the window it resets the part instead | reload, window option |
//! | key 0x5555 | opens prescaler, reload and window for writing; any other key closes them | register access protection |
//! | PR, RLR, WINR | reach the LSI's side five of its cycles after a write, while PVU, RVU or WVU stands, during which they are not written again; a new window loads the counter | PR, RLR, SR, WINR |
//! | counter at zero | resets the part | functional description |
//!
//! Not here: the hardware option (the option bytes are as delivered, which is software), low-power modes, and the
//! freeze by a debugger: a halted core halts virtual time.

use rigless::device::{Device, DeviceContext as Context, Level, RegisterFile};
use rigless::soc::Layout;
use rigless::soc::stm32h743::generated::iwdg::{Register, sr};
use rigless::soc::stm32h743::peripherals::rcc::IWDG_STARTED;
use rigless::time::{EventId, NANOS_PER_SECOND, VirtualNanos};

const KEY_OPEN: u64 = 0x5555;
const KEY_START: u64 = 0xCCCC;
const KEY_RELOAD: u64 = 0xAAAA;
/// Reset value of reload and window, and where the counter starts.
const FULL: u64 = 0xFFF;
/// Cycles of the LSI until a written register counts.
const CROSSING_CYCLES: u64 = 5;
/// What is written through the LSI's side, and the flag of a value on its way.
const CROSSING: [(Register, u64); 3] =
    [(Register::Pr, sr::PVU.mask()), (Register::Rlr, sr::RVU.mask()), (Register::Winr, sr::WVU.mask())];

/// The three values, on either side, and what they are after a reset.
type Values = [u64; CROSSING.len()];
const RESET: Values = [0, FULL, FULL];

#[derive(Debug, Default)]
pub struct Iwdg {
    open: bool,
    started: bool,
    /// As written.
    written: Values,
    /// As the counter has them.
    values: Values,
    /// When the next of them arrives, by register.
    arrivals: [Option<EventId>; CROSSING.len()],
    clock_hz: u64,
    /// The counter, which the start loads, and cycles of the LSI into the present count, at this time.
    counter: (u64, u64, u64),
    end: Option<EventId>,
}

impl Iwdg {
    pub fn new() -> Self {
        Self { written: RESET, values: RESET, ..Self::default() }
    }

    /// Cycles of the LSI for a count: 4 to 256.
    fn divider(&self) -> u64 {
        4 << self.values[0].min(6)
    }

    fn cycles_ns(&self, cycles: u64) -> u64 {
        (u128::from(cycles) * u128::from(NANOS_PER_SECOND)).div_ceil(u128::from(self.clock_hz)) as u64
    }

    /// Carry the counter on to `now`, with clock and prescaler as they were until then.
    fn count(&mut self, now: VirtualNanos) {
        let (since, counter, cycles) = self.counter;
        let passed = u128::from(now.0 - since) * u128::from(self.clock_hz) / u128::from(NANOS_PER_SECOND);
        let cycles = cycles + passed as u64;
        let counts = cycles / self.divider();
        // What is left of a cycle stays in the time.
        let whole = if self.clock_hz == 0 { now.0 } else { since + self.cycles_ns(passed as u64) };
        self.counter = (whole.min(now.0), counter.saturating_sub(counts), cycles % self.divider());
    }

    fn load(&mut self, now: VirtualNanos, value: u64) {
        self.counter = (now.0, value, 0);
    }

    /// The reset, at the end of the count.
    fn arm(&mut self, context: &mut Context<'_>) {
        self.end = (self.started && self.clock_hz != 0).then(|| {
            let (since, counter, cycles) = self.counter;
            let left = (counter + 1) * self.divider() - cycles;
            context.schedule(VirtualNanos(since + self.cycles_ns(left)))
        });
    }

    fn reload(&mut self, context: &mut Context<'_>) {
        self.count(context.now());
        let [_, reload, window] = self.values;
        if self.counter.1 > window {
            context.request_reset();
            return;
        }
        self.load(context.now(), reload);
        self.arm(context);
    }

    fn take_key(&mut self, key: u64, context: &mut Context<'_>) {
        self.open = key == KEY_OPEN;
        match key {
            KEY_START if !self.started => {
                self.started = true;
                self.load(context.now(), FULL);
                context.request(IWDG_STARTED, Level::High);
                self.arm(context);
            }
            KEY_RELOAD if self.started => self.reload(context),
            KEY_OPEN | KEY_START | KEY_RELOAD => {}
            _ => context.tell("KR", "a key that the manual does not have"),
        }
    }

    /// Let `index` arrive after its cycles, once there is a clock.
    fn send(&mut self, index: usize, context: &mut Context<'_>) {
        self.arrivals[index] = (self.clock_hz != 0).then(|| {
            let at = context.now().0 + self.cycles_ns(CROSSING_CYCLES);
            context.schedule(VirtualNanos(at))
        });
    }

    fn take_value(&mut self, index: usize, registers: &mut RegisterFile, context: &mut Context<'_>) {
        let (register, flag) = CROSSING[index];
        let status = registers.get(Register::Sr);
        if !self.open || status & flag != 0 {
            let why =
                if self.open { "written while its last value is on its way" } else { "written while closed" };
            context.tell(register.spec().name, why);
            registers.set(register, self.written[index]);
            return;
        }
        self.written[index] = registers.get(register);
        registers.set(Register::Sr, status | flag);
        self.send(index, context);
    }

    fn arrive(&mut self, index: usize, registers: &mut RegisterFile, context: &mut Context<'_>) {
        self.arrivals[index] = None;
        self.count(context.now());
        self.values[index] = self.written[index];
        let (register, flag) = CROSSING[index];
        registers.set(Register::Sr, registers.get(Register::Sr) & !flag);
        if register == Register::Winr {
            self.load(context.now(), self.values[1]);
        }
        self.arm(context);
    }
}

impl Device for Iwdg {
    type Register = Register;

    fn read(
        &mut self,
        register: Register,
        file: &mut RegisterFile,
        context: &mut Context<'_>,
    ) -> Option<u64> {
        self.peek(register, file, context.now())
    }

    fn peek(&self, register: Register, _: &RegisterFile, _: VirtualNanos) -> Option<u64> {
        // Read from the counter's side.
        let index = CROSSING.iter().position(|&(crossing, _)| crossing == register)?;
        Some(self.values[index])
    }

    fn write(&mut self, register: Register, value: u64, file: &mut RegisterFile, context: &mut Context<'_>) {
        match CROSSING.iter().position(|&(crossing, _)| crossing == register) {
            Some(index) => self.take_value(index, file, context),
            None if register == Register::Kr => self.take_key(value & 0xFFFF, context),
            None => {}
        }
    }

    fn on_event(&mut self, event: EventId, file: &mut RegisterFile, context: &mut Context<'_>) {
        if self.end == Some(event) {
            context.request_reset();
        }
        for index in 0..CROSSING.len() {
            if self.arrivals[index] == Some(event) {
                self.arrive(index, file, context);
            }
        }
    }

    fn on_clock(&mut self, hz: u64, file: &mut RegisterFile, context: &mut Context<'_>) {
        self.count(context.now());
        self.clock_hz = hz;
        for (index, (_, flag)) in CROSSING.into_iter().enumerate() {
            if file.get(Register::Sr) & flag != 0 {
                self.send(index, context);
            }
        }
        self.arm(context);
    }
}

#[cfg(test)]
mod tests {
    use rigless::device::ResetCause;
    use rigless::mcu::{Operate, Single};
    use rigless::soc::{Layout, Width, stm32h743};
    use rigless::time::VirtualNanos;

    use super::{Iwdg, KEY_OPEN, KEY_RELOAD, KEY_START, Register};

    const LSI_HZ: u64 = 32_000;
    const MS: u64 = 1_000_000;

    struct Part(Single<Iwdg>);

    impl Part {
        /// As the drivers do it: configured, started, loaded. 800 counts of four cycles are the firmware's 100 ms. The
        /// clock comes with the start.
        fn started() -> Self {
            let single = Single::new(stm32h743::builder(), "IWDG", Iwdg::new());
            let mut part = Self(single.expect("the part has the instance"));
            for (register, value) in
                [(Register::Kr, KEY_OPEN), (Register::Pr, 0), (Register::Rlr, 799), (Register::Kr, KEY_START)]
            {
                part.write(0, register, value);
            }
            part.0.drive(VirtualNanos(0), |iwdg, registers, context| {
                rigless::device::Device::on_clock(iwdg, LSI_HZ, registers, context);
            });
            part
        }

        fn address(register: Register) -> u64 {
            0x5800_4800 + u64::from(register.spec().offset)
        }

        fn write(&mut self, at_ns: u64, register: Register, value: u64) {
            self.0.advance_to(VirtualNanos(at_ns));
            let address = Self::address(register);
            self.0.write(VirtualNanos(at_ns), address, Width::W32, value).expect("the instance answers");
        }

        fn read(&mut self, at_ns: u64, register: Register) -> u64 {
            self.0.advance_to(VirtualNanos(at_ns));
            self.0
                .read(VirtualNanos(at_ns), Self::address(register), Width::W32)
                .expect("the instance answers")
        }

        fn has_bitten(&mut self, at_ns: u64) -> bool {
            self.0.advance_to(VirtualNanos(at_ns));
            self.0.take_reset_request() == Some(ResetCause::Model("IWDG"))
        }
    }

    /// After a reload, the reload value and one count later; without any, at the end of the full count.
    #[test]
    fn unfed_it_resets_the_part() {
        let fed: Vec<u64> = (1..100).map(|nth| nth * 99 * MS).collect();
        for (reloads, end) in [(vec![], 512 * MS), (vec![MS], 101 * MS), (fed, 99 * 99 * MS + 100 * MS)] {
            let mut part = Part::started();
            for at in reloads {
                part.write(at, Register::Kr, KEY_RELOAD);
                assert!(!part.has_bitten(at), "fed at {at} ns");
            }
            assert!(!part.has_bitten(end - 1), "{end} ns");
            assert!(part.has_bitten(end), "{end} ns");
        }
    }

    #[test]
    fn another_prescaler_counts_five_cycles_after_it_was_written() {
        let mut part = Part::started();
        let crossed = 5 * 1_000_000_000 / LSI_HZ;
        assert_eq!(part.read(crossed - 1, Register::Sr), 0b011);
        assert_eq!(part.read(crossed - 1, Register::Rlr), 0xFFF);
        assert_eq!(part.read(crossed, Register::Sr), 0);
        assert_eq!(part.read(crossed, Register::Rlr), 799);
        part.write(10 * MS, Register::Kr, KEY_OPEN);
        part.write(10 * MS, Register::Pr, 6);
        part.write(20 * MS, Register::Kr, KEY_RELOAD);
        // 256 cycles each.
        assert!(!part.has_bitten(20 * MS + 6_400 * MS - 1));
        assert!(part.has_bitten(20 * MS + 6_400 * MS));
    }

    #[test]
    fn what_is_closed_is_not_written() {
        let mut part = Part::started();
        part.write(10 * MS, Register::Rlr, 5);
        assert_eq!(part.read(20 * MS, Register::Rlr), 799);
    }

    #[test]
    fn a_reload_before_the_window_resets_the_part() {
        let mut part = Part::started();
        part.write(10 * MS, Register::Kr, KEY_OPEN);
        part.write(10 * MS, Register::Winr, 400);
        assert_eq!(part.read(20 * MS, Register::Winr), 400);
        assert!(!part.has_bitten(21 * MS));
        part.write(22 * MS, Register::Kr, KEY_RELOAD);
        assert!(part.has_bitten(22 * MS));
    }
}
