//! The pins of a NUCLEO-144 (MB1364).

/// Pins and peripherals of a NUCLEO-144, from what `embassy_stm32::init` gives.
///
/// | what | pins |
/// |---|---|
/// | addresses, lowest first: five of columns, five of rows | PE2 to PE11 |
/// | outputs of the arrays | PA3, PC0, PB1: ADC1 inputs 15, 10, 5 |
/// | SPI1 | PA5 SCK, PA6 MISO, PB5 MOSI; chip selects PD14, PD15, PG12 |
/// | FDCAN1 | PD0 RX, PD1 TX |
/// | red LED | PB14 |
macro_rules! nucleo_144 {
    ($chip:ident, $board:literal) => {
        Hardware {
            board: $board,
            fault_led: $chip.PB14.into(),
            fdcan: $chip.FDCAN1,
            can_rx: $chip.PD0,
            can_tx: $chip.PD1,
            flash: $chip.FLASH,
            watchdog: $chip.IWDG1,
            scan: $crate::stm32::scan::Hardware {
                timer: $chip.TIM8,
                adc: $chip.ADC1,
                codes_dma: $chip.DMA1_CH0,
                address_dma: $chip.DMA2_CH2,
                // PE0 has no place on the connectors beside them, PE1 is the yellow LED.
                address: [
                    $chip.PE2.into(),
                    $chip.PE3.into(),
                    $chip.PE4.into(),
                    $chip.PE5.into(),
                    $chip.PE6.into(),
                    $chip.PE7.into(),
                    $chip.PE8.into(),
                    $chip.PE9.into(),
                    $chip.PE10.into(),
                    $chip.PE11.into(),
                ],
                arrays: [
                    ::embassy_stm32::adc::AdcChannel::degrade_adc($chip.PA3),
                    ::embassy_stm32::adc::AdcChannel::degrade_adc($chip.PC0),
                    ::embassy_stm32::adc::AdcChannel::degrade_adc($chip.PB1),
                ],
            },
            accelerometers: $crate::stm32::accelerometers::Hardware {
                spi: $chip.SPI1,
                sck: $chip.PA5,
                miso: $chip.PA6,
                mosi: $chip.PB5,
                tx_dma: $chip.DMA2_CH1,
                rx_dma: $chip.DMA2_CH0,
                chip_selects: [$chip.PD14.into(), $chip.PD15.into(), $chip.PG12.into()],
            },
        }
    };
}
pub(crate) use nucleo_144;
