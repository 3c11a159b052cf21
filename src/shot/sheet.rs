//! Printable sheets at true scale: checkerboards, ChArUco boards and tags, as SVG or PDF.
//!
//! A [`Sheet`] is a page in millimetres with black rectangles and a line of text; both writers print
//! exactly those numbers. Every sheet carries a bar of 50 mm: printers like to shrink pages.

use pdf_writer::{Content, Finish, Name, Pdf, Rect, Ref, Str};

use super::detect::{self, DetectError};

/// A page with black rectangles, in millimetres from its upper left corner.
#[derive(Clone, Debug, PartialEq)]
pub struct Sheet {
    pub width_mm: f64,
    pub height_mm: f64,
    /// Left, top, width, height.
    pub black_mm: Vec<[f64; 4]>,
    /// What it is and how to print it.
    pub caption: String,
}

/// Why a target cannot be printed.
#[derive(Debug, thiserror::Error, PartialEq)]
pub enum SheetError {
    #[error(
        "the pattern needs {need_mm0:.0} × {need_mm1:.0} mm with its margins, the page has {page_mm0:.0} × \
         {page_mm1:.0}; use a larger page (--page A3 or --page 600x450) or a smaller pattern"
    )]
    TooLarge { need_mm0: f64, need_mm1: f64, page_mm0: f64, page_mm1: f64 },
    #[error("\"{0}\" is no page: A4, A3, A2, letter, or WIDTHxHEIGHT in mm (up to 5000)")]
    Page(String),
    #[error("{0}")]
    Size(String),
    #[error(transparent)]
    Pattern(#[from] DetectError),
}

/// Free space the caption and the scale bar need below a pattern, mm.
const FOOT_MM: f64 = 14.0;
/// Free space along the other edges, mm: most printers leave less.
const MARGIN_MM: f64 = 6.0;
/// Length of the scale bar, mm.
const BAR_MM: f64 = 50.0;
const CAPTION_MM: f64 = 2.8;
/// Sides of the black and white cells: two dots of a printer of 600 dpi to the longest page.
const PRINTABLE_MM: std::ops::RangeInclusive<f64> = 0.08..=5000.0;
const POINTS_PER_MM: f64 = 72.0 / 25.4;

/// Width and height of a page, mm: a name or `WIDTHxHEIGHT`.
pub fn page_mm(name: &str) -> Result<[f64; 2], SheetError> {
    let wrong = || SheetError::Page(name.to_owned());
    Ok(match name.to_ascii_lowercase().as_str() {
        "a4" => [210.0, 297.0],
        "a3" => [297.0, 420.0],
        "a2" => [420.0, 594.0],
        "letter" => [215.9, 279.4],
        other => {
            let (w, h) = other.split_once('x').ok_or_else(wrong)?;
            let side = |s: &str| {
                s.trim()
                    .parse::<f64>()
                    .ok()
                    .filter(|v| *v >= 20.0 && *v <= 5000.0)
                    .ok_or_else(wrong)
            };
            [side(w)?, side(h)?]
        }
    })
}

/// A checkerboard with this many inner corners; upright its upper left square is black.
pub fn checkerboard(
    columns: usize,
    rows: usize,
    square_mm: f64,
    page: [f64; 2],
) -> Result<Sheet, SheetError> {
    let most = detect::CHECKERBOARD_CORNERS;
    if !(most.contains(&columns) && most.contains(&rows)) {
        let (least, most) = (most.start(), most.end());
        return Err(SheetError::Size(format!(
            "{columns} × {rows} inner corners cannot be found again; both counts must lie between \
             {least} and {most}"
        )));
    }
    let (wide, high) = (columns + 1, rows + 1);
    let cells: Vec<bool> = (0..wide * high).map(|k| (k % wide + k / wide) % 2 == 1).collect();
    let hint = if (columns + rows).is_multiple_of(2) {
        "; looks the same upside down: one odd and one even count are better"
    } else {
        ""
    };
    let caption =
        format!("checkerboard, {columns} x {rows} inner corners, squares {square_mm} mm{hint}");
    // A white rim of half a square lets the outer squares be seen as squares.
    lay_out(&cells, wide, square_mm, 0.5 * square_mm, page, caption)
}

/// A ChArUco board of `columns × rows` squares; markers are three quarters of a square.
pub fn charuco(
    columns: usize,
    rows: usize,
    square_mm: f64,
    page: [f64; 2],
) -> Result<Sheet, SheetError> {
    let most = detect::CHARUCO_CORNERS;
    let (across, down) = (columns.saturating_sub(1), rows.saturating_sub(1));
    let fits = most.contains(&across) && most.contains(&down) && columns * rows / 2 <= 250;
    if !fits || across * down < detect::FEWEST_CHARUCO_CORNERS {
        let (least, most, fewest) = (most.start(), most.end(), detect::FEWEST_CHARUCO_CORNERS);
        return Err(SheetError::Size(format!(
            "{across} × {down} inner corners cannot be found again; {least} to {most} each way, at \
             least {fewest} in all, and at most 250 markers"
        )));
    }
    let (per_square, cells) = detect::charuco_pattern(columns, rows)?;
    let caption = format!(
        "ChArUco, {} x {} inner corners, squares {square_mm} mm, markers {} mm (4x4)",
        columns - 1,
        rows - 1,
        0.75 * square_mm
    );
    let cell = square_mm / per_square as f64;
    lay_out(&cells, columns * per_square, cell, 0.25 * square_mm, page, caption)
}

/// One AprilTag; `size_mm` is the outer edge of its black border.
pub fn tag(family: &str, id: u32, size_mm: f64, page: [f64; 2]) -> Result<Sheet, SheetError> {
    let (side, cells) = detect::tag_pattern(family, id)?;
    let caption = format!("AprilTag {family}, id {id}, black border {size_mm} mm outside");
    let cell = size_mm / side as f64;
    // Detectors need one white cell around; two are safer on dark ground.
    lay_out(&cells, side, cell, 2.0 * cell, page, caption)
}

/// Puts cells (row-major, true is white) on the page, turned to landscape if only that fits.
fn lay_out(
    cells: &[bool],
    columns: usize,
    cell_mm: f64,
    rim_mm: f64,
    page: [f64; 2],
    caption: String,
) -> Result<Sheet, SheetError> {
    if !PRINTABLE_MM.contains(&cell_mm) {
        return Err(SheetError::Size(format!(
            "a cell of {cell_mm:?} mm cannot be printed; cells of {} to {} mm can",
            PRINTABLE_MM.start(),
            PRINTABLE_MM.end()
        )));
    }
    let rows = cells.len() / columns;
    let (width, height) = (columns as f64 * cell_mm, rows as f64 * cell_mm);
    let rim = rim_mm.max(MARGIN_MM);
    let need = [width + 2.0 * rim, height + rim + rim.max(FOOT_MM)];
    let fits = |p: [f64; 2]| need[0] <= p[0] && need[1] <= p[1];
    let turned = [page[1], page[0]];
    let page = match (fits(page), fits(turned)) {
        (true, _) => page,
        (false, true) => turned,
        _ => {
            return Err(SheetError::TooLarge {
                need_mm0: need[0],
                need_mm1: need[1],
                page_mm0: page[0],
                page_mm1: page[1],
            });
        }
    };
    let left = 0.5 * (page[0] - width);
    let top = (0.5 * (page[1] - height)).min(page[1] - height - rim.max(FOOT_MM));
    let mut black_mm = vec![];
    for (row, line) in cells.chunks(columns).enumerate() {
        // Runs of black become one rectangle: no hairlines between cells.
        let mut at = 0;
        while at < columns {
            let run = line[at..].iter().take_while(|white| !**white).count();
            if run > 0 {
                let (x, y) = (left + at as f64 * cell_mm, top + row as f64 * cell_mm);
                black_mm.push([x, y, run as f64 * cell_mm, cell_mm]);
            }
            at += run.max(1);
        }
    }
    black_mm.push([MARGIN_MM, page[1] - MARGIN_MM, BAR_MM, 0.5]);
    let caption =
        format!("{caption}. Print at 100 %: the bar is {BAR_MM} mm. This edge is the lower one.");
    Ok(Sheet { width_mm: page[0], height_mm: page[1], black_mm, caption })
}

impl Sheet {
    /// The sheet as SVG: user units are millimetres.
    pub fn svg(&self) -> String {
        use svg::node::element::{Rectangle, Text};
        let (w, h) = (self.width_mm, self.height_mm);
        let mut document = svg::Document::new()
            .set("width", format!("{w}mm"))
            .set("height", format!("{h}mm"))
            .set("viewBox", (0.0, 0.0, w, h))
            .add(Rectangle::new().set("width", w).set("height", h).set("fill", "white"));
        for [x, y, width, height] in &self.black_mm {
            document = document.add(
                Rectangle::new()
                    .set("x", *x)
                    .set("y", *y)
                    .set("width", *width)
                    .set("height", *height)
                    .set("shape-rendering", "crispEdges"),
            );
        }
        let text = Text::new(self.caption.as_str())
            .set("x", MARGIN_MM)
            .set("y", h - MARGIN_MM - 1.5)
            .set("font-size", CAPTION_MM)
            .set("font-family", "Helvetica, Arial, sans-serif");
        document.add(text).to_string()
    }

    /// Its drawing commands in PDF points, y up.
    fn content(&self) -> Vec<u8> {
        let points = |mm: f64| (mm * POINTS_PER_MM) as f32;
        let mut content = Content::new();
        for [x, y, width, height] in &self.black_mm {
            let bottom = self.height_mm - y - height;
            content.rect(points(*x), points(bottom), points(*width), points(*height));
        }
        content.fill_nonzero();
        content.begin_text();
        content.set_font(Name(b"F"), points(CAPTION_MM));
        content.next_line(points(MARGIN_MM), points(MARGIN_MM + 1.5));
        content.show(Str(self.caption.as_bytes()));
        content.end_text();
        content.finish().to_vec()
    }
}

/// The sheets as one PDF, a page each.
pub fn pdf(sheets: &[Sheet]) -> Vec<u8> {
    let mut next = 1;
    let mut id = || {
        next += 1;
        Ref::new(next - 1)
    };
    let (catalog, tree, font) = (id(), id(), id());
    let pages: Vec<(Ref, Ref)> = sheets.iter().map(|_| (id(), id())).collect();
    let mut pdf = Pdf::new();
    pdf.catalog(catalog).pages(tree);
    pdf.pages(tree).kids(pages.iter().map(|(page, _)| *page)).count(sheets.len() as i32);
    for (sheet, (page, content)) in sheets.iter().zip(&pages) {
        let (w, h) = (sheet.width_mm * POINTS_PER_MM, sheet.height_mm * POINTS_PER_MM);
        let mut written = pdf.page(*page);
        written.media_box(Rect::new(0.0, 0.0, w as f32, h as f32)).parent(tree).contents(*content);
        written.resources().fonts().pair(Name(b"F"), font);
        written.finish();
        pdf.stream(*content, &sheet.content());
    }
    pdf.type1_font(font).base_font(Name(b"Helvetica"));
    pdf.finish()
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn a_square_of_the_pdf_is_25_mm() {
        let sheet = checkerboard(9, 6, 25.0, page_mm("A3").unwrap()).unwrap();
        let bytes = pdf(std::slice::from_ref(&sheet));
        let text = String::from_utf8_lossy(&bytes).into_owned();
        let rectangles: Vec<Vec<f64>> = text
            .lines()
            .filter_map(|l| l.strip_suffix(" re"))
            .map(|l| l.split(' ').map(|v| v.parse().unwrap()).collect())
            .collect();
        // 35 black squares of 10 × 7, and the bar.
        assert_eq!(rectangles.len(), 36);
        let to_mm = |points: f64| points * 25.4 / 72.0;
        for r in &rectangles[..35] {
            assert!(
                (to_mm(r[2]) - 25.0).abs() < 1e-4 && (to_mm(r[3]) - 25.0).abs() < 1e-4,
                "{r:?}"
            );
        }
        assert!((to_mm(rectangles[35][2]) - 50.0).abs() < 1e-4);
        // A3 upright, which the board fits: 841.89 × 1190.55 pt.
        assert!(text.contains("/MediaBox [0 0 841.88") && text.contains(" 1190.55"), "{text:.300}");
        // The first square is the upper left one.
        let highest = rectangles[..35].iter().map(|r| r[1]).fold(0.0, f64::max);
        assert_eq!(rectangles[0][1], highest);
        let leftmost = rectangles[..35].iter().map(|r| r[0]).fold(f64::MAX, f64::min);
        assert_eq!(rectangles[0][0], leftmost);
    }

    #[test]
    fn svg_says_millimetres() {
        let text = checkerboard(4, 3, 25.0, page_mm("a4").unwrap()).unwrap().svg();
        assert!(text.contains("width=\"210mm\"") && text.contains("viewBox=\"0 0 210 297\""));
        assert!(text.contains("width=\"25\"") && text.contains("height=\"25\""));
    }

    #[test]
    fn patterns_that_do_not_fit_say_what_they_need() {
        let error = checkerboard(9, 6, 40.0, page_mm("A4").unwrap()).unwrap_err();
        assert!(error.to_string().contains("440"), "{error}");
        assert!(checkerboard(1, 6, 10.0, [210.0, 297.0]).is_err());
        // The detector needs three each way: a sheet that nothing finds is not printed.
        assert!(checkerboard(2, 6, 10.0, [210.0, 297.0]).is_err());
        assert!(matches!(charuco(3, 5, 10.0, [210.0, 297.0]), Err(SheetError::Size(_))));
        assert!(checkerboard(9, 6, f64::NAN, [210.0, 297.0]).is_err());
        assert!(checkerboard(9, 6, -1.0, [210.0, 297.0]).is_err());
        assert!(checkerboard(9, 6, 1e-9, [210.0, 297.0]).is_err());
        let huge = checkerboard(9, 6, 1e300, [210.0, 297.0]).unwrap_err().to_string();
        assert!(huge.contains("1e300") && huge.len() < 100, "{huge}");
        for page in ["", "A", "1x2", "axb", "1e9x5", "NaNxNaN"] {
            assert!(page_mm(page).is_err(), "{page}");
        }
        assert_eq!(page_mm("600 x 450").unwrap(), [600.0, 450.0]);
    }

    #[cfg(feature = "opencv")]
    #[test]
    fn tag_is_as_large_as_it_says() {
        let sheet = tag("36h11", 7, 120.0, [210.0, 297.0]).unwrap();
        let tag_cells = &sheet.black_mm[..sheet.black_mm.len() - 1];
        let left = tag_cells.iter().map(|r| r[0]).fold(f64::MAX, f64::min);
        let right = tag_cells.iter().map(|r| r[0] + r[2]).fold(0.0, f64::max);
        assert!((right - left - 120.0).abs() < 1e-9);
        assert!(tag("36h11", 587, 120.0, [210.0, 297.0]).is_err());
        assert!(tag("nonsense", 0, 120.0, [210.0, 297.0]).is_err());
        let board = charuco(7, 5, 30.0, [297.0, 210.0]).unwrap();
        assert!(board.black_mm.len() > 35);
    }
}
