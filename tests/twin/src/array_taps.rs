//! The taxel arrays at the emulator's peripherals: address lines, trigger, ADC inputs and DMA streams.

use rigless::device::{DeviceContext as Context, ErasedDevice, Level, RegisterFile};
use rigless::soc::stm32h743::generated::adc3::Register as AdcRegister;
use rigless::soc::stm32h743::generated::gpioa::Register as PortRegister;
use rigless::soc::stm32h743::generated::tim1::Register;
use rigless::soc::stm32h743::peripherals::adc::{Adc, Channel};
use rigless::soc::stm32h743::peripherals::dma::Dma;
use rigless::soc::stm32h743::peripherals::gpio::Gpio;
use rigless::soc::stm32h743::peripherals::tim::{Advanced, Tim};
use rigless::soc::{Layout, Width};
use rigless::time::{EventId, VirtualNanos};
use slipsense::params::TAXELS;

use crate::arrays::Shared;
use crate::bus_tap::{TRIGGER_TOKEN, Tap};
use crate::scan_timing::{CHANNELS, FIRST_PIN, LINES, LINES_MODER, OUTPUTS};
use crate::shared::lock;

/// ADC1_ISR, a write of 0 to which does nothing: the trigger line's way over the emulator's bus.
const ADC1_ISR: u64 = 0x4002_2000;
/// TIM_CR1 and TIM_EGR.
const CEN: u64 = 1 << 0;
const UG: u64 = 1 << 0;
/// ADC_CR and ADC_CFGR.
const ADSTART: u64 = 1 << 2;
const ADSTP: u64 = 1 << 4;
const EXTEN: u64 = 0b11 << 10;
const EXTEN_RISING: u64 = 0b01 << 10;
const EXTSEL: u64 = 0b11111 << 5;
/// External trigger 7 of the regular group is TIM8_TRGO.
const TIM8_TRGO: u64 = 7 << 5;

/// On port E: the address.
#[derive(Debug)]
pub struct AddressLines(pub Shared);

impl Tap<Gpio> for AddressLines {
    fn show(&mut self, registers: &mut RegisterFile, now: VirtualNanos) {
        lock(&self.0).fast_scan.show_port(registers, now.0);
    }

    /// A short between lines, or to ground, as the pins see it.
    fn read(&mut self, row: usize, value: Option<u64>, registers: &RegisterFile) -> Option<u64> {
        if row != PortRegister::Idr.index() {
            return value;
        }
        value.map(|levels| lock(&self.0).pins(levels, registers.get(PortRegister::Moder)))
    }

    /// A set/reset of address lines alone stays here: the emulator would tell every edge to thirty models that can
    /// listen to a pin, which takes longer than all the rest of a slot, and none of them listens to these.
    fn write(
        &mut self,
        row: usize,
        value: u64,
        registers: &mut RegisterFile,
        _: &mut Context<'_>,
    ) -> Option<u64> {
        let outputs = registers.get(PortRegister::Moder) & LINES_MODER == LINES_MODER & OUTPUTS;
        if row == PortRegister::Bsrr.index() && outputs && value & !(LINES | LINES << 16) == 0 {
            // BSRR: the low half sets, the high half clears, setting wins (RM0433, GPIO bit set/reset register).
            let lines = registers.get(PortRegister::Odr) & !(value >> 16) | value & 0xFFFF;
            registers.set(PortRegister::Odr, lines);
            return None;
        }
        Some(value)
    }

    fn after(&mut self, _: &mut Gpio, registers: &mut RegisterFile, context: &mut Context<'_>) {
        let lines = registers.get(PortRegister::Odr) >> FIRST_PIN;
        let mut arrays = lock(&self.0);
        if !arrays.fast_scan.runs() {
            arrays.addressed(lines as usize % TAXELS, context.now().0);
        }
    }
}

/// On TIM8: a rising TRGO.
#[derive(Debug)]
pub struct Trigger {
    pub shared: Shared,
    pub high: bool,
    pub pulses: u64,
}

impl Tap<Tim<Advanced>> for Trigger {
    fn read_instead(&mut self, row: usize, registers: &RegisterFile, now: VirtualNanos) -> Option<u64> {
        let count = lock(&self.shared).fast_scan.count(now.0)?;
        let file = || Register::from_index(row).map_or(0, |register| registers.get(register));
        Some(if row == Register::Cnt.index() { count } else { file() })
    }

    fn write(
        &mut self,
        row: usize,
        value: u64,
        registers: &mut RegisterFile,
        context: &mut Context<'_>,
    ) -> Option<u64> {
        let arrays = &mut lock(&self.shared);
        let starts = row == Register::Cr1.index() && value & CEN != 0;
        if arrays.fast_scan.runs() {
            if starts || row != Register::Cr1.index() {
                context.tell("CR1", "a write to the timer of a scan that runs: needs --slow");
            }
            arrays.stop_scan(context.now().0);
        } else if starts && arrays.fast_scan.start(context) {
            return None;
        } else if starts && arrays.fast_scan.enabled {
            arrays.fast_scan.by_events += 1;
        }
        if row == Register::Egr.index() {
            arrays.fast_scan.fresh = value & UG != 0 && registers.get(Register::Cr1) & CEN == 0;
        }
        Some(value)
    }

    fn event_instead(&mut self, event: EventId, context: &mut Context<'_>) -> bool {
        lock(&self.shared).frame_ended(event, context)
    }

    fn answered(&mut self, token: u64, value: u64, context: &mut Context<'_>) {
        lock(&self.shared).fast_scan.answered(token, value, context);
    }

    fn on_clock(&mut self, hz: u64, now: VirtualNanos) {
        lock(&self.shared).fast_scan.timer = (now.0, hz);
    }

    fn reset(&mut self) {
        lock(&self.shared).fast_scan.reset();
    }

    fn after(&mut self, timer: &mut Tim<Advanced>, _: &mut RegisterFile, context: &mut Context<'_>) {
        let (level, pulses) = timer.trigger_output();
        let high = level == Level::High;
        if high && !self.high || pulses != self.pulses {
            lock(&self.shared).triggered = true;
            context.write_to(ADC1_ISR, Width::W32, 0, TRIGGER_TOKEN);
        }
        (self.high, self.pulses) = (high, pulses);
    }
}

/// On ADC1: external triggers (RM0433, conversion on external trigger), and the inputs.
///
/// The emulator's model never sees EXTEN and EXTSEL, and ADSTART only when a trigger comes.
#[derive(Debug)]
pub struct TriggeredInputs {
    pub shared: Shared,
    external: u64,
    armed: bool,
    /// A trigger came with this write.
    starts: bool,
    /// A sequence runs: ADSTART after the last call, which a write to CR no longer finds in the register file.
    converting: bool,
}

impl TriggeredInputs {
    pub const fn new(shared: Shared) -> Self {
        Self { shared, external: 0, armed: false, starts: false, converting: false }
    }

    fn start(&mut self, adc: &mut Adc, registers: &mut RegisterFile, context: &mut Context<'_>) {
        if registers.get(AdcRegister::Cr) & ADSTART != 0 {
            context.tell("ADC_CR", "a trigger while the sequence before still runs is lost");
            return;
        }
        let value = registers.get(AdcRegister::Cr) | ADSTART;
        registers.set(AdcRegister::Cr, value);
        ErasedDevice::write(adc, AdcRegister::Cr.index(), value, registers, context);
    }
}

impl Tap<Adc> for TriggeredInputs {
    fn before(&mut self, adc: &mut Adc, now: VirtualNanos) {
        let arrays = lock(&self.shared);
        let conversion_ns = arrays.fast_scan.conversion_ns();
        for (sensor, channel) in CHANNELS.into_iter().enumerate() {
            let code = arrays.code(sensor, now.0.saturating_sub(conversion_ns));
            if let Some(channel) = Channel::new(channel) {
                adc.set_input(channel, code * 1000 + 500);
            }
        }
    }

    fn write(
        &mut self,
        row: usize,
        mut value: u64,
        registers: &mut RegisterFile,
        context: &mut Context<'_>,
    ) -> Option<u64> {
        if row == AdcRegister::Cfgr.index() {
            self.external = value & (EXTEN | EXTSEL);
            value &= !(EXTEN | EXTSEL);
            registers.set(AdcRegister::Cfgr, value);
            if self.external & EXTEN != 0 && self.external & EXTSEL != TIM8_TRGO {
                context.tell("ADC_CFGR", "an external trigger that the twin has no line for");
            }
        } else if row == AdcRegister::Cr.index() && self.external & EXTEN != 0 {
            if value & ADSTP != 0 && self.armed {
                self.armed = false;
                if !self.converting {
                    // Nothing runs that would have to be stopped.
                    value &= !ADSTP;
                }
            } else if value & ADSTART != 0 {
                self.armed = true;
            }
            value &= !ADSTART;
            registers
                .set(AdcRegister::Cr, registers.get(AdcRegister::Cr) & !(ADSTART | ADSTP) | value & ADSTP);
        }
        let arrays = &mut lock(&self.shared);
        arrays.fast_scan.armed = self.armed && self.external == EXTEN_RISING | TIM8_TRGO;
        if row == AdcRegister::Isr.index() {
            let triggered = std::mem::take(&mut arrays.triggered);
            self.starts = triggered && self.armed && self.external & EXTEN == EXTEN_RISING;
        } else if arrays.fast_scan.runs() {
            context.tell("CR", "a write to the ADC of a scan that runs: needs --slow");
        }
        Some(value)
    }

    fn read(&mut self, row: usize, value: Option<u64>, registers: &RegisterFile) -> Option<u64> {
        if row == AdcRegister::Cfgr.index() {
            return Some(value.unwrap_or_else(|| registers.get(AdcRegister::Cfgr)) | self.external);
        }
        if row == AdcRegister::Cr.index() && self.armed {
            return Some(value.unwrap_or_else(|| registers.get(AdcRegister::Cr)) | ADSTART);
        }
        value
    }

    fn after(&mut self, adc: &mut Adc, registers: &mut RegisterFile, context: &mut Context<'_>) {
        if std::mem::take(&mut self.starts) {
            self.start(adc, registers, context);
        }
        self.converting = registers.get(AdcRegister::Cr) & ADSTART != 0;
    }

    fn on_clock(&mut self, hz: u64, _now: VirtualNanos) {
        lock(&self.shared).fast_scan.adc_hz = hz;
    }

    fn reset(&mut self) {
        (self.external, self.armed, self.converting) = (0, false, false);
    }
}

/// On DMA1 and DMA2: the two streams of the scan.
#[derive(Debug)]
pub struct Streams {
    pub shared: Shared,
    /// DMA1, whose stream 0 fetches the codes; else DMA2, whose stream 2 writes the addresses.
    pub codes: bool,
}

impl Tap<Dma> for Streams {
    fn show(&mut self, registers: &mut RegisterFile, now: VirtualNanos) {
        lock(&self.shared).fast_scan.show_stream(self.codes, registers, now.0);
    }

    fn write(
        &mut self,
        row: usize,
        value: u64,
        _: &mut RegisterFile,
        context: &mut Context<'_>,
    ) -> Option<u64> {
        if lock(&self.shared).fast_scan.is_in_use(self.codes, row) {
            context.tell("CR", "a write to a stream of a scan that runs: needs --slow");
        }
        Some(value)
    }

    fn after(&mut self, _: &mut Dma, registers: &mut RegisterFile, _: &mut Context<'_>) {
        lock(&self.shared).fast_scan.stream_written(self.codes, registers);
    }
}
