"""The report as PDF, when the program for it is installed."""

import pathlib

INSTALL = "install it: sudo apt-get install weasyprint (or print report.html from a browser)"


def write_pdf(html_path, pdf_path):
    """Print a page to PDF. Returns the PDF's path. Raises ValueError when that is not possible here."""
    try:
        import weasyprint
    except (ImportError, OSError) as error:  # OSError: its libraries are missing
        raise ValueError("a PDF needs WeasyPrint, which cannot be used here (%s): %s" % (error, INSTALL)) from error
    weasyprint.HTML(filename=str(html_path)).write_pdf(str(pdf_path))
    return pathlib.Path(pdf_path)
