"""`python -m data_extraction.report BAG`: the report of any bag, as one HTML page. Needs no ROS master."""

import os
import pathlib
import sys

from data_extraction.bags import Bag, BagError
from data_extraction.command_line import bag_parser, folder_beside, run
from data_extraction.progress import Progress, bar
from data_extraction.report import page
from data_extraction.report.collector import ReportCollector
from data_extraction.report.origin import read_beside

_SHOW_EVERY = 200  # messages
INSTALL = "install it: sudo apt-get install weasyprint (or print report.html from a browser)"


def make(bag_path, folder=None, fleet_path=None, pdf=False, progress=None):
    """Write report.html of a bag. Returns [paths of what was written].

    folder: default beside the bag: the bag's own folder for a flight of `maap fly` (flight.bag), else BAG_report.
    fleet_path: default fleet.yaml beside the bag. Raises ValueError, also BagError, and OSError.
    """
    bag_path = pathlib.Path(bag_path)
    progress = progress or Progress()
    with Bag(bag_path) as bag:
        collector = ReportCollector(bag, read_beside(bag_path, fleet_path))
        if not collector.wanted:
            raise BagError("%s holds nothing to report; %s" % (bag_path, bag.contents))
        size_gb = 1e-9 * bag_path.stat().st_size
        for number, (topic, receipt_s, message) in enumerate(bag.messages(collector.wanted)):
            collector(topic, receipt_s, message)
            if number % _SHOW_EVERY == 0:
                progress.show("reading", "%s of %.2f GB" % (bar(bag.fraction(receipt_s)), size_gb))
        progress.show("evaluating")
        material = collector.material()
    progress.show("drawing")
    own = bag_path.parent if bag_path.name == "flight.bag" else folder_beside(bag_path, "report")
    folder = pathlib.Path(folder or own)
    folder.mkdir(parents=True, exist_ok=True)
    files = [page.write(folder / "report.html", material, page.summary_of(material))]
    if pdf:
        progress.show("printing")
        files.append(write_pdf(files[0], folder / "report.pdf"))
    return files


def write_pdf(html_path, pdf_path):
    """Print a page to PDF. Returns the PDF's path. Raises ValueError when that is not possible here."""
    try:
        import weasyprint
    except (ImportError, OSError) as error:  # OSError: its libraries are missing
        raise ValueError("a PDF needs WeasyPrint, which cannot be used here (%s): %s" % (error, INSTALL)) from error
    weasyprint.HTML(filename=str(html_path)).write_pdf(str(pdf_path))
    return pdf_path


def main(argv=None):
    """Command line. Returns the exit code."""
    parser = bag_parser("maap report", __doc__.partition(": ")[2])
    parser.add_argument("--pdf", action="store_true", help="also write report.pdf (needs WeasyPrint)")
    args = parser.parse_args(argv)

    def work(progress):
        for path in make(args.bag, args.out, args.fleet, args.pdf, progress):
            progress.say("")
            print(os.path.relpath(str(path)))

    return run(parser.prog, work)


if __name__ == "__main__":
    sys.exit(main())
