"""Images of PDS4 products: labels that GDAL writes, and labels as missions publish them."""

import random
import warnings

import numpy as np
import pytest

from craternav_fg.cli.app import app
from craternav_fg.dataset import Dataset
from craternav_fg.errors import InputError
from craternav_fg.importing.images import grey_images, stamp_of, stamps_of
from craternav_fg.importing.pds4 import read_pds4
from tests.fuzz.mutate import raw, text
from tests.importing.test_images import _given

LABEL = """<?xml version="1.0" encoding="UTF-8"?>
<Product_Observational xmlns="http://pds.nasa.gov/pds4/pds/v1" xmlns:disp="http://pds.nasa.gov/pds4/disp/v1">
  <Observation_Area>
    <Time_Coordinates>
      <start_date_time>2023-10-01T12:00:0{second}.250Z</start_date_time>
      <stop_date_time>2023-10-01T12:00:0{second}.350Z</stop_date_time>
    </Time_Coordinates>
    <Discipline_Area><disp:Display_Settings><disp:Display_Direction>
      <disp:horizontal_display_direction>{across}</disp:horizontal_display_direction>
      <disp:vertical_display_direction>{down}</disp:vertical_display_direction>
    </disp:Display_Direction></disp:Display_Settings></Discipline_Area>
  </Observation_Area>
  <File_Area_Observational>
    <File><file_name>{file}</file_name></File>
    <Header><offset unit="byte">0</offset><object_length unit="byte">16</object_length></Header>
    <Array_2D_Image>
      <offset unit="byte">16</offset>
      <axes>2</axes>
      <axis_index_order>Last Index Fastest</axis_index_order>
      <Element_Array><data_type>{kind}</data_type>{scaling}</Element_Array>
      <Axis_Array><axis_name>{axes[0]}</axis_name><elements>{sizes[0]}</elements>
        <sequence_number>1</sequence_number></Axis_Array>
      <Axis_Array><axis_name>{axes[1]}</axis_name><elements>{sizes[1]}</elements>
        <sequence_number>2</sequence_number></Axis_Array>
      {constants}
    </Array_2D_Image>
  </File_Area_Observational>
</Product_Observational>
"""


def product(folder, stored, kind, name="one", **given):
    """Write an array and its label, as a mission publishes them; give the label."""
    (folder / f"{name}.img").write_bytes(b"sixteen bytes of" + stored.tobytes())
    words = {
        "second": 1, "across": "Left to Right", "down": "Top to Bottom", "file": f"{name}.img", "kind": kind,
        "scaling": "", "axes": ("Line", "Sample"), "sizes": stored.shape, "constants": "",
    }  # fmt: skip
    path = folder / f"{name}.xml"
    path.write_text(LABEL.format(**{**words, **given}))
    return path


IMAGE = np.arange(12).reshape(3, 4)


@pytest.mark.parametrize("dtype", ["uint8", "uint16", "int16", "float32"])
def test_products_that_gdal_writes(tmp_path, dtype):
    rasterio = pytest.importorskip("rasterio")
    path = tmp_path / "gdal.xml"
    with warnings.catch_warnings():
        warnings.simplefilter("ignore", rasterio.errors.NotGeoreferencedWarning)
        size = {"width": 4, "height": 3, "count": 1}
        with rasterio.open(path, "w", driver="PDS4", dtype=dtype, **size) as raster:
            raster.write(20 * IMAGE.astype(dtype), 1)
    read = read_pds4(path)
    np.testing.assert_array_equal(read.pixels(), 20 * IMAGE)
    assert read.pixels().dtype == (dtype if dtype.startswith("u") else np.float64)
    with pytest.raises(InputError, match=r"gdal.xml: start_date_time: expected a time, .*: give --times"):
        read.middle()


@pytest.mark.parametrize(
    ("kind", "dtype"),
    [("UnsignedByte", "u1"), ("UnsignedMSB2", ">u2"), ("SignedMSB4", ">i4"), ("IEEE754MSBSingle", ">f4")],
)
def test_types_and_byte_orders(tmp_path, kind, dtype):
    read = read_pds4(product(tmp_path, IMAGE.astype(dtype), kind))
    np.testing.assert_array_equal(read.pixels(), IMAGE)
    assert stamp_of(read.middle()) == 1_696_161_601_300_000_000


def test_the_display_direction_turns_the_image_upright(tmp_path):
    upwards = product(tmp_path, IMAGE[::-1].astype("u1"), "UnsignedByte", down="Bottom to Top")
    np.testing.assert_array_equal(read_pds4(upwards).pixels(), IMAGE)
    leftwards = product(tmp_path, IMAGE[:, ::-1].astype("u1"), "UnsignedByte", across="Right to Left")
    np.testing.assert_array_equal(read_pds4(leftwards).pixels(), IMAGE)
    columns = np.ascontiguousarray(IMAGE.T).astype("u1")
    by_columns = product(tmp_path, columns, "UnsignedByte", axes=("Sample", "Line"))
    np.testing.assert_array_equal(read_pds4(by_columns).pixels(), IMAGE)


def test_scale_and_special_constants(tmp_path):
    stored = IMAGE.astype("<i2")
    stored[0] = [-32768, -32767, -32766, 7]
    path = product(
        tmp_path, stored, "SignedLSB2",
        scaling="<scaling_factor>0.5</scaling_factor><value_offset>10</value_offset>",
        constants="<Special_Constants><missing_constant>-32768</missing_constant>"
        "<high_instrument_saturation>-32767</high_instrument_saturation>"
        "<low_representation_saturation>-32766</low_representation_saturation></Special_Constants>",
    )  # fmt: skip
    expected = 0.5 * IMAGE + 10.0
    # Saturated pixels are as bright as the brightest; row 0 ends in 7, the largest number is 11.
    expected[0] = [np.nan, 15.5, np.nan, 13.5]
    np.testing.assert_array_equal(read_pds4(path).pixels(), expected)
    # 12 grey levels a unit: from 12 (4 stored) to 15.5 in 255 steps.
    (levels,) = grey_images([path], bit_depth=8)
    assert levels.dtype == np.uint8
    assert levels.tolist()[0] == [0, 255, 0, 109]
    assert levels.tolist()[1:] == [[0, 36, 73, 109], [146, 182, 219, 255]]


def test_products_become_a_data_set_with_the_times_of_their_labels(tmp_path):
    _given(tmp_path)
    rng = np.random.default_rng(3)
    images = [rng.integers(0, 256, (48, 64), dtype=np.uint8) for _ in range(2)]
    paths = [
        product(tmp_path, image, "UnsignedByte", f"p{k}", second=4 - k) for k, image in enumerate(images)
    ]
    options = {"-o": "data", "--camera": "sensor.yaml", "--catalog": "craters.csv"}
    named = [part for name, value in options.items() for part in (name, str(tmp_path / value))]
    app(["import", "images", *map(str, paths), *named, "--sun", "0,3,4"], standalone_mode=False)
    data = Dataset.open(tmp_path / "data")
    assert [path.name for path in data.image_paths] == ["p1.png", "p0.png"]
    assert data.stamps_ns.tolist() == [1_696_161_603_300_000_000, 1_696_161_604_300_000_000]
    np.testing.assert_array_equal(data.image(1), images[0])
    with pytest.raises(InputError, match=r"0.png: has no time of its own, .*: give --times"):
        stamps_of([tmp_path / "0.png"], None)


def whole(path):
    """Read all of a product."""
    image = read_pds4(path)
    return image.middle(), image.pixels()


def test_wrong_labels_are_refused_in_one_line(tmp_path):
    def found(old, new):
        path = product(tmp_path, IMAGE.astype("u1"), "UnsignedByte")
        assert old in path.read_text()
        path.write_text(path.read_text().replace(old, new))
        with pytest.raises(InputError) as caught:
            whole(path)
        return str(caught.value)

    assert "one.xml: expected a PDS4 label, found no XML" in found("</Header>", "")
    assert "of Product_Observational, found Product_Browse" in found(
        "Product_Observational", "Product_Browse"
    )
    assert "expected an Array_2D_Image" in found("Array_2D_Image", "Table_Binary")
    assert "data_type: expected UnsignedByte, " in found("UnsignedByte", "UnsignedBitString")
    assert "axis_index_order: expected Last Index Fastest, found 'First" in found("Last Index", "First Index")
    assert "Axis_Array: expected axes Line and Sample alone, found 4 along Band" in found("Sample<", "Band<")
    assert "elements: expected a whole number from 1, found '-3'" in found(">3<", ">-3<")
    assert "file_name: expected a file beside the label, found '../one.img'" in found("one.img", "../one.img")
    assert "two.img: file is missing" in found("one.img", "two.img")
    assert "one.img: is truncated: expected 116 bytes, as" in found(">3<", ">25<")
    assert "expected an exposure of at most 1 s, found 8.1 s: give --times" in found("01.350", "09.350")
    assert "start_date_time: expected a time, found 'noon'" in found("2023-10-01T12:00:01.250Z", "noon")
    assert "offset: expected it in Array_2D_Image, found none" in found(
        '<offset unit="byte">16</offset>', "<offset/>"
    )


def test_spoilt_labels_end_in_an_image_or_in_one_line(tmp_path):
    path = product(tmp_path, IMAGE.astype("u1"), "UnsignedByte")
    sound = path.read_bytes()
    rng = random.Random(1)
    said = []
    for _ in range(300):
        path.write_bytes(sound)
        rng.choice([raw, text])(path, rng)
        try:
            whole(path)
        except InputError as error:
            said.append(str(error))
    assert 100 < len(said) < 300
    assert not [line for line in said if "\n" in line]
