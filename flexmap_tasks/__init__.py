"""FlexMap: georeference HD maps and carry OpenStreetMap knowledge into them."""
