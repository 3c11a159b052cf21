//! The colour in the middle of many.

use crate::conventions::Rgb;

/// Median of each channel on its own, the upper one of an even number; `None` of no colours.
pub fn median_per_channel(colours: &[Rgb]) -> Option<Rgb> {
    if colours.is_empty() {
        return None;
    }
    let middle = colours.len() / 2;
    let channel = |c: usize| {
        let mut values: Vec<f32> = colours.iter().map(|colour| colour[c]).collect();
        *values.select_nth_unstable_by(middle, f32::total_cmp).1
    };
    Some(Rgb::new(channel(0), channel(1), channel(2)))
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn channels_have_their_own_middles() {
        let colours = [[1.0, 9.0, 5.0], [3.0, 8.0, 4.0], [2.0, 7.0, 6.0]].map(Rgb::from_array);
        assert_eq!(median_per_channel(&colours), Some(Rgb::new(2.0, 8.0, 5.0)));
        assert_eq!(median_per_channel(&colours[..2]), Some(Rgb::new(3.0, 9.0, 5.0)));
        assert_eq!(median_per_channel(&[]), None);
    }
}
