//! The pins of the NUCLEO-H743ZI2 (MB1364), and what is connected to each inside the chip.

use embassy_stm32::adc::AdcChannel;
use embassy_stm32::gpio::AnyPin;
use embassy_stm32::{Peri, Peripherals, peripherals};

use crate::{accelerometers, adc_scan};

/// Pins and peripherals in use: the book's wiring page says what is behind them.
pub struct Hardware {
    /// Red.
    pub fault_led: Peri<'static, AnyPin>,
    pub fdcan: Peri<'static, peripherals::FDCAN1>,
    pub can_rx: Peri<'static, peripherals::PD0>,
    pub can_tx: Peri<'static, peripherals::PD1>,
    pub flash: Peri<'static, peripherals::FLASH>,
    /// Resets the node when it is not fed.
    pub watchdog: Peri<'static, peripherals::IWDG1>,
    pub scan: adc_scan::Hardware,
    pub accelerometers: accelerometers::Hardware,
}

/// What the firmware uses of the chip.
///
/// | what | pins |
/// |---|---|
/// | addresses, lowest first: five of columns, five of rows | PE2 to PE11 |
/// | outputs of the arrays | PA3, PC0, PB1: ADC1 inputs 15, 10, 5 |
/// | SPI1 | PA5 SCK, PA6 MISO, PB5 MOSI; chip selects PD14, PD15, PG12 |
/// | FDCAN1 | PD0 RX, PD1 TX |
/// | red LED | PB14 |
pub fn assign(chip: Peripherals) -> Hardware {
    Hardware {
        fault_led: chip.PB14.into(),
        fdcan: chip.FDCAN1,
        can_rx: chip.PD0,
        can_tx: chip.PD1,
        flash: chip.FLASH,
        watchdog: chip.IWDG1,
        scan: adc_scan::Hardware {
            timer: chip.TIM8,
            adc: chip.ADC1,
            codes_dma: chip.DMA1_CH0,
            address_dma: chip.DMA2_CH2,
            // PE0 has no place on the connectors beside them, PE1 is the yellow LED.
            address: [
                chip.PE2.into(),
                chip.PE3.into(),
                chip.PE4.into(),
                chip.PE5.into(),
                chip.PE6.into(),
                chip.PE7.into(),
                chip.PE8.into(),
                chip.PE9.into(),
                chip.PE10.into(),
                chip.PE11.into(),
            ],
            arrays: [chip.PA3.degrade_adc(), chip.PC0.degrade_adc(), chip.PB1.degrade_adc()],
        },
        accelerometers: accelerometers::Hardware {
            spi: chip.SPI1,
            sck: chip.PA5,
            miso: chip.PA6,
            mosi: chip.PB5,
            tx_dma: chip.DMA2_CH1,
            rx_dma: chip.DMA2_CH0,
            chip_selects: [chip.PD14.into(), chip.PD15.into(), chip.PG12.into()],
        },
    }
}
